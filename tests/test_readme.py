"""README's Python runs as it stands."""

import re
from pathlib import Path

import numpy as np

import jaxgrasp
from benchmarks import readme

README = Path(__file__).parent.parent / "README.md"


def test_the_ten_lines_run(capsys):
    code, hand = re.findall(r"```python\n(.*?)```", README.read_text(), re.S)
    assert len(code.strip().splitlines()) <= 16 and len(hand.strip().splitlines()) <= 8
    names: dict = {}
    exec(compile(code, "README", "exec"), names)
    assert capsys.readouterr().out
    best, wrench = names["best"], names["wrench"]
    assert jaxgrasp.Verdict(int(best.verdict)).solved
    np.testing.assert_allclose(np.asarray(best.forces).sum(0), np.asarray(wrench)[:3], atol=1e-9)
    assert names["by_squeeze"].shape == (3, 3, 3)
    exec(compile(hand, "README", "exec"), names)
    assert "STABLE" in capsys.readouterr().out


def test_the_tables_are_those_of_the_committed_results():
    assert readme.filled(README.read_text()) == README.read_text()


def test_the_quick_start_has_two_lines():
    block = re.search(r"<!-- quick start -->\n```bash\n(.*?)```\n<!-- end -->", README.read_text(), re.S)
    assert block and len(block[1].strip().splitlines()) == 2
