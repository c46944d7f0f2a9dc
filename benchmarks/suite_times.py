"""A pytest plugin: CPU seconds of each test, child processes included, to the file that JAXGRASP_TEST_TIMES names."""

import json
import os
import resource
from pathlib import Path

import pytest

_SPENT: dict[str, float] = {}


def _cpu_seconds() -> float:
    return sum(resource.getrusage(target).ru_utime for target in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    start_s = _cpu_seconds()
    result = yield
    _SPENT[item.nodeid] = _cpu_seconds() - start_s
    return result


def pytest_sessionfinish():
    if path := os.environ.get("JAXGRASP_TEST_TIMES"):
        Path(path).write_text(json.dumps(_SPENT))
