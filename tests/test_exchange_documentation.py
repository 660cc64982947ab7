"""The examples of docs/observations-file.md do what the page says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from excavatwin.exchange import load_observations
from excavatwin.exchange.archive import PER_VIEW, SHARED
from excavatwin.vocabularies import read_vocabulary, shipped_vocabularies
from site_example import example_observations
from test_exchange_roundtrip import plain

PAGE = (Path(__file__).parents[1] / "docs" / "observations-file.md").read_text("utf-8")


def block(language: str) -> str:
    found = re.search(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    assert found
    return found.group(1)


def test_the_python_example_loads(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(block("python"), {})
    (view,) = load_observations("yard.npz").views
    assert view.evidence[0, 0].tolist() == [1, 0, 0, 0, 0]
    np.testing.assert_allclose(view.points[..., 2], 0, atol=1e-5)


def test_the_mapping_example_reads(tmp_path):
    (tmp_path / "own.toml").write_text(block("toml"))
    assert len(read_vocabulary(tmp_path / "own.toml").names) == 3


def test_every_key_and_every_shipped_mapping_is_on_the_page():
    documented = set(re.findall(r"`([\w-]+)`", PAGE))
    assert {*PER_VIEW, *SHARED} - {"provenance"} <= documented
    assert set(shipped_vocabularies()) <= documented


@pytest.mark.parametrize("key", ["points", "confidence", "T_world_cam", "K"])
def test_the_required_keys_are_required(key, tmp_path):
    arrays = plain(example_observations(1))
    del arrays[key]
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ValueError, match=f"has no '{key}'"):
        load_observations(tmp_path / "a.npz")
