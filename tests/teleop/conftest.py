"""The workplace of the peg task, compiled once; without the extra ``hands`` these tests are skipped."""

import importlib.util

import pytest

from jaxgrasp.teleop import Workplace


@pytest.fixture(scope="session")
def workplace() -> Workplace:
    for package in ("mujoco", "gymnasium_robotics"):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    return Workplace("peg")
