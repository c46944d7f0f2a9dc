"""The key of two hosts: read where nobody else can, and refused where others could."""

import os

import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.glove.network.messages import VARIABLE, load_key

KEY = bytes(range(16))


@pytest.fixture
def key_file(folder, monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    path = folder / "glove.key"
    path.write_text(KEY.hex() + "\n")
    path.chmod(0o600)
    return path


def test_it_comes_from_the_file_or_the_environment(key_file, monkeypatch):
    assert load_key() == b"" and load_key(key_file) == KEY
    monkeypatch.setenv(VARIABLE, KEY[::-1].hex())
    assert load_key() == KEY[::-1] and load_key(key_file) == KEY, "the file goes first"


@pytest.mark.skipif(os.name != "posix", reason="others' rights are POSIX'")
@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602, 0o644])
def test_a_file_that_others_can_read_is_refused(key_file, mode):
    key_file.chmod(mode)
    with pytest.raises(ValueError, match="can be read by others: .*chmod 600"):
        load_key(key_file)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no key", "is not hexadecimal: expected 32 to 128"),
        ("0f" * 15, "holds 15 bytes: expected 32 to 128"),
        ("0f" * 65, "holds 65 bytes"),
        ("", "holds 0 bytes"),
        ("\xff" * 40, "is not hexadecimal"),
    ],
)
def test_what_is_no_key(key_file, text, message):
    key_file.write_text(text, encoding="latin-1")
    with pytest.raises(ValueError, match=message):
        load_key(key_file)


def test_no_key_is_warned_of_before_anything_else(key_file, capsys):
    """At run time, by the command alone."""
    run = ["glove", "run", "--connect", "localhost:1", "--tracker", "nowhere"]
    assert main(run) == 1
    message = capsys.readouterr().err
    assert "warning: no key" in message and "nowhere cannot be opened" in message
    assert main([*run, "--key-file", "glove.key"]) == 1
    assert "warning" not in capsys.readouterr().err
