"""Does each extra install alone in a fresh environment, and are its backbones ready then?

    python benchmarks/extras.py                 # all extras, one after another (gigabytes, minutes)
    python benchmarks/extras.py onnx yoloe      # some

For each extra: a new virtual environment, ``pip install ".[extra]"``, then ``excavatwin backbones NAME --json`` for the
backbones whose install line names the extra: which of their modules are still missing (model code that is not on PyPI),
and whether the ones that are there can be imported. Prints a table; exit code 1 when an extra does not install.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
NOT_BACKBONES = ("dev", "sim", "study")


def main() -> int:
    """Install, ask, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    parser.add_argument("extras", nargs="*", default=[name for name in known if name not in NOT_BACKBONES])
    failed = False
    print(f"{'extra':<18}{'installs':<10}{'size':<10}{'time':<8}backbones")
    for extra in parser.parse_args().extras:
        with tempfile.TemporaryDirectory(prefix=f"extra-{extra}-") as folder:
            failed |= not _try(extra, Path(folder))
    return int(failed)


def _try(extra: str, folder: Path) -> bool:
    begin = time.monotonic()
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
    python = folder / "venv" / "bin" / "python"
    constraints = [word for name in ("constraints.txt", "constraints-backbones.txt") for word in ("-c", ROOT / name)]
    done = subprocess.run(
        [python, "-m", "pip", "install", "--quiet", *constraints, f"{ROOT}[{extra}]"], capture_output=True, text=True
    )
    size = sum(f.stat().st_size for f in (folder / "venv").rglob("*") if f.is_file()) / 1e9
    states = _states(python, extra) if done.returncode == 0 else [done.stderr.strip().splitlines()[-1]]
    seconds = time.monotonic() - begin
    print(f"{extra:<18}{'yes' if done.returncode == 0 else 'NO':<10}{size:<6.1f} GB {seconds:>5.0f} s ", end="")
    print("; ".join(states), flush=True)
    shutil.rmtree(folder / "venv")
    return done.returncode == 0


def _states(python: Path, extra: str) -> list[str]:
    asked = subprocess.run([python, "-m", "excavatwin", "backbones", "--json"], capture_output=True, text=True)
    rows = [row for row in json.loads(asked.stdout) if f"[{extra}]" in row["card"]["install"]]
    found = []
    for row in rows:
        here = [module for module in row["card"]["modules"] if module not in row["missing"]]
        words = "; ".join(f"import {module}" for module in here) or "pass"
        imports = subprocess.run([python, "-c", words], capture_output=True, text=True)
        broken = "" if imports.returncode == 0 else f", IMPORT FAILS: {imports.stderr.strip().splitlines()[-1]}"
        rest = f"wants {', '.join(row['missing'])} by its second command" if row["missing"] else "ready"
        found.append(f"{row['card']['name']}: {rest}{broken}")
    return found


if __name__ == "__main__":
    sys.exit(main())
