"""Import of pyarrow, which reads and writes Parquet; the extra ``table`` installs it."""

from typing import IO, Any

from jaxgrasp.validation.optional_library import optional_library

MISSING = "Parquet files need pyarrow: pip install 'jaxgrasp[table]'"


def arrow_library() -> Any:
    """Import pyarrow with its modules for Parquet, compute functions and file systems, and return it.

    Raises:
        ImportError: if it is not installed; the message names the command that installs it.
    """
    return optional_library("pyarrow", "pyarrow.compute", "pyarrow.fs", "pyarrow.parquet", missing=MISSING)


def parquet_writer(arrow: Any, stream: IO[bytes], schema: Any) -> Any:
    """Create a Parquet writer on ``stream``, with page checksums and with dictionary encoding of text columns alone.

    Numbers rarely repeat: without dictionaries for them, writing takes a quarter of the time.
    """
    texts = [field.name for field in schema if arrow.types.is_string(field.type)]
    return arrow.parquet.ParquetWriter(stream, schema, use_dictionary=texts, write_page_checksum=True)
