"""pyarrow, which reads and writes Parquet; the extra ``table`` brings it."""

from typing import Any

MISSING = "Parquet files need pyarrow: pip install 'jaxgrasp[table]'"


def arrow_library() -> Any:
    """pyarrow with its modules for Parquet and for computing.

    Raises:
        ImportError: where it is not installed, with the command that does it.
    """
    try:
        import pyarrow
        import pyarrow.compute
        import pyarrow.parquet
    except ImportError:
        raise ImportError(MISSING) from None
    return pyarrow
