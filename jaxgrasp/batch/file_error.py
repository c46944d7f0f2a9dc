"""The error of every reader."""

import os


class GraspFileError(ValueError):
    """A file that cannot be used, and why."""

    def __init__(self, path: str | os.PathLike, reason: str):
        super().__init__(f"{os.fspath(path)}: {reason}")
        self.path = path
        self.reason = reason
