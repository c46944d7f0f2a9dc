"""Error that every reader and writer of grasp files raises."""

import os


class GraspFileError(ValueError):
    """Error of a file that cannot be used: its path and the reason."""

    def __init__(self, path: str | os.PathLike, reason: str):
        super().__init__(f"{os.fspath(path)}: {reason}")
        self.path = path
        self.reason = reason
