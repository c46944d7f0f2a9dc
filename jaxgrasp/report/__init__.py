"""The report of an evaluation, and pictures of grasps: HTML files that open offline (extra ``report``)."""

from jaxgrasp.report.page import write_report
from jaxgrasp.report.shown_grasp import show

__all__ = ["show", "write_report"]


def __dir__() -> list[str]:
    return __all__
