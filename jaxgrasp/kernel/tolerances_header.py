"""Generator of ``tolerances.h``: the thresholds of ``jaxgrasp.problem.tolerances`` as C++ constants.

    python -m jaxgrasp.kernel.tolerances_header

A test compares the file with what this returns.
"""

from dataclasses import fields
from pathlib import Path

import numpy as np

from jaxgrasp.problem.tolerances import Tolerances, tolerances

HEADER = Path(__file__).with_name("tolerances.h")


def header_text() -> str:
    """Return the text of ``tolerances.h``."""
    structures = "\n".join([_structure("double", np.dtype(np.float64)), _structure("float", np.dtype(np.float32))])
    return f"""// Thresholds in the scaled coordinates, which jaxgrasp/problem/tolerances.py explains.
// `python -m jaxgrasp.kernel.tolerances_header` generates this file: do not edit.
#ifndef JAXGRASP_KERNEL_TOLERANCES_H
#define JAXGRASP_KERNEL_TOLERANCES_H

namespace jaxgrasp {{

template <class Real> struct Tolerances;

{structures}
}}  // namespace jaxgrasp

#endif
"""


def _structure(name: str, dtype: np.dtype) -> str:
    """Return the constants of one precision."""
    values = tolerances(dtype)
    names = [field.name for field in fields(values)]
    lines = [f"  static constexpr {name} {field} = {_literal(values, field, name)};" for field in names]
    return "\n".join([f"template <> struct Tolerances<{name}> {{", *lines, "};", ""])


def _literal(values: Tolerances, field: str, type_name: str) -> str:
    number = repr(float(getattr(values, field)))
    return number if type_name == "double" else f"float({number})"


if __name__ == "__main__":
    HEADER.write_text(header_text())
