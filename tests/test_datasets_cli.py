"""``excavatwin datasets`` as a user runs it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import oces_example
import rellis_example
from excavatwin.datasets import SOURCES, open_dataset
from excavatwin.errors import InputError


def cli(*words: str | Path, datasets: Path | None = None) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if name != "EXCAVATWIN_DATASETS"}
    environment |= {"COLUMNS": "100", "NO_COLOR": "1"}
    environment |= {"EXCAVATWIN_DATASETS": str(datasets)} if datasets else {}
    command = [sys.executable, "-m", "excavatwin", "datasets", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False, timeout=300)


def sentence(result: subprocess.CompletedProcess[str]) -> str:
    assert result.returncode == 2, result.stderr
    said = [line for line in result.stderr.splitlines() if not line.startswith("[")]
    assert len(said) == 1, said
    return said[0]


def test_without_a_folder_it_says_what_to_download(tmp_path) -> None:
    (tmp_path / "isprs").mkdir()
    result = cli(datasets=tmp_path)
    assert result.returncode == 0, result.stderr
    assert max(map(len, result.stdout.splitlines())) <= 118
    for source in SOURCES:
        assert source.licence in result.stdout
        assert f"$EXCAVATWIN_DATASETS/{source.name}" in result.stdout
    assert "isprs (there is such a folder)" in result.stdout
    assert "orfd (there is no such folder)" in result.stdout


def test_help_can_be_copied() -> None:
    result = cli("--help")
    assert result.returncode == 0
    examples = [line for line in result.stdout.splitlines() if line.startswith("  excavatwin ")]
    assert len(examples) == 4
    assert max(map(len, examples)) < 80


def test_a_folder_is_recognised_tested_and_counted(tmp_path) -> None:
    rellis_example.write(tmp_path / "rellis-3d")
    by_path, by_name = cli(tmp_path / "rellis-3d"), cli("rellis-3d", "--all", datasets=tmp_path)
    for result in (by_path, by_name):
        assert result.returncode == 0, result.stderr
        assert result.stdout.startswith("rellis-3d in ")
        assert "labelled returns agree with the photo" in result.stdout
        assert "policies: diggable, strict" in result.stdout
        assert "train 1, val 1, test 0" in result.stdout
        assert "missing" in result.stdout
    assert "read       files 9 of recordings 1, unusable 0" in by_path.stdout  # 3 photos, 3 labels, 3 of 6 scans
    assert "read       files 12" in by_name.stdout


def test_unusable_files_are_listed_and_end_with_code_2(tmp_path) -> None:
    root = oces_example.write(tmp_path / "yard")
    (root / "site_007/epoch_01/images/000001.jpg").write_bytes(b"\xff\xd8")
    result = cli(root)
    assert "1 of 26 files that were read cannot be used" in sentence(result)
    assert "unusable" in result.stdout
    assert "000001.jpg cannot be decoded" in " ".join(result.stdout.split())


def test_bad_input_is_answered_with_one_sentence(tmp_path) -> None:
    (tmp_path / "file.txt").write_text("x")
    rellis_example.write(tmp_path / "wrong", photos={1: 1}, inverted=True)
    (tmp_path / "empty").mkdir()
    assert "the layout of no known data set" in sentence(cli(tmp_path / "empty"))
    assert "holds the other direction" in sentence(cli(tmp_path / "wrong"))
    assert "is a file" in sentence(cli(tmp_path / "file.txt"))
    assert "does not exist; give a folder, or one of: rellis-3d" in sentence(cli(tmp_path / "nowhere"))
    assert "--all reads the files of a data set" in sentence(cli("--all"))


def test_names_are_looked_for_below_the_environment_variable(tmp_path, monkeypatch) -> None:
    monkeypatch.delenv("EXCAVATWIN_DATASETS", raising=False)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="EXCAVATWIN_DATASETS, which is not set"):
        open_dataset("isprs")
    monkeypatch.setenv("EXCAVATWIN_DATASETS", str(tmp_path / "sets"))
    with pytest.raises(InputError, match=r"isprs does not exist; `excavatwin datasets` says"):
        open_dataset("isprs")
    (tmp_path / "sets" / "isprs").mkdir(parents=True)
    np.savez(tmp_path / "sets" / "isprs" / "samp99.npz", xyz=np.zeros((2, 3), np.float32), ground=np.ones(2, np.uint8))
    assert open_dataset("isprs").names == ("samp99",)
    with pytest.raises(InputError, match="no folder of a data set is given"):
        open_dataset([])
