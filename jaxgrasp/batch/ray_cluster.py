"""Ray, which places work on the machines of a cluster and does it again where one fails; the extra ``cluster``."""

import logging
import os
import socket
import sys
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from jaxgrasp.validation.optional_library import optional_library

MISSING = "--cluster needs Ray: pip install 'jaxgrasp[cluster]'"
SETTINGS = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_BACKEND_LOG_LEVEL": "fatal", "RAY_worker_niceness": "0"}
"""Settings of Ray's own processes: nothing is sent to its makers, warnings of its inner working are not shown, and
workers are as urgent as the command, where Ray would have them wait for all else that runs on the machine."""
LOCAL = "local"
OBJECT_STORE = 200 << 20
"""Bytes of Ray's shared memory on this machine: what passes through it are names and reports."""

CONNECT_SECONDS = 10.0
STARTS = 3
"""Ray gives up after half a minute, which on a machine that is busy is too little to start in."""


class ClusterError(OSError):
    """A cluster that cannot be reached, or that cannot go on."""


def ray_library() -> Any:
    """Ray.

    Raises:
        ImportError: where it is not installed, with the command that does it.
    """
    return optional_library("ray", missing=MISSING)


@contextmanager
def connected(where: str, cpus: int | None = None) -> Iterator[Any]:
    """Ray, connected until the block ends; one that this process is connected to already is taken, and left.

    Args:
        where: ``"local"`` starts one on this machine alone, and ends it; ``"auto"`` takes the one that is running
            here, or the one that ``RAY_ADDRESS`` names; anything else is an address.
        cpus: of this machine, for a local one; all where not given.

    Raises:
        ImportError: where Ray is not installed.
        ClusterError: where there is none at that address.
    """
    with _settings(), _quiet_logs():
        ray = ray_library()
        if ray.is_initialized():
            yield ray
            return
        _check_address(where)
        _begin(ray, where, cpus)
        try:
            yield ray
        finally:
            ray.shutdown()


def _begin(ray: Any, where: str, cpus: int | None) -> None:
    own = {"num_cpus": cpus, "object_store_memory": OBJECT_STORE, "include_dashboard": False}
    for left in reversed(range(STARTS if where == LOCAL else 1)):
        try:
            with _no_stderr():
                ray.init(
                    address=where,
                    log_to_driver=False,
                    logging_level=logging.CRITICAL,
                    configure_logging=False,
                    **(own if where == LOCAL else {}),
                )
            return
        except Exception as error:  # Ray lets out errors of many kinds, plain ones too.
            ray.shutdown()
            if not left:
                line = str(error).strip().split("\n")[0]
                if where == LOCAL:
                    raise ClusterError(f"Ray does not start on this machine ({line})") from None
                raise _not_found(where, line) from None


def _not_found(where: str, why: object) -> ClusterError:
    return ClusterError(f"no cluster is found at {where!r} ({why}): ray start --head begins one")


def _check_address(where: str) -> None:
    """That somebody listens at ``HOST:PORT``, since Ray itself takes minutes to give up.

    Raises:
        ClusterError: where nobody does.
    """
    host, _, port = where.rpartition(":")
    if not host or "/" in host or not port.isdecimal():
        return
    try:
        socket.create_connection((host, int(port)), CONNECT_SECONDS).close()
    except (OSError, OverflowError) as error:
        raise _not_found(where, error) from None


@contextmanager
def _settings() -> Iterator[None]:
    """Ray reads them as it is imported and when it starts processes; what the user set stays."""
    added = {name: value for name, value in SETTINGS.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)


@contextmanager
def _no_stderr() -> Iterator[None]:
    """Nothing on stderr, where Ray's compiled part says as it starts that it will be quiet."""
    sys.stderr.flush()
    kept = os.dup(2)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


@contextmanager
def _quiet_logs() -> Iterator[None]:
    logger = logging.getLogger("ray")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


def mapped(
    ray: Any, worker: type, arguments: tuple, items: Sequence[Any], workers: int | None, gpus: float
) -> Generator[Any, None, None]:
    """What ``worker(*arguments).report(item)`` returns of each item, as they are done.

    Args:
        ray: what ``connected`` gave.
        worker: a class, of which each process of the cluster keeps an instance.
        arguments: of its constructor.
        items: what to do; one whose process or machine is lost is done again.
        workers: processes, of one core each; one for each core of the cluster where not given.
        gpus: of each process.

    Raises:
        ClusterError: where the cluster cannot go on.
    """
    size = min(workers or max(1, int(ray.cluster_resources().get("CPU", 1))), len(items))
    kind = ray.remote(num_cpus=1, num_gpus=gpus or None, max_restarts=-1, max_task_retries=-1)(worker)
    left = deque(items)
    begun: dict[Any, Any] = {}
    at_work: dict[Any, Any] = {}
    try:
        for _ in range(size):
            actor = kind.remote(*arguments)
            begun[actor.__ray_ready__.remote()] = actor
        while left or at_work:
            (done,), _ = ray.wait([*begun, *at_work])
            reports = done in at_work
            actor = (at_work if reports else begun).pop(done)
            found = ray.get(done)
            if left:
                at_work[actor.report.remote(left.popleft())] = actor
            else:
                # Its core may be needed by one that has lost its machine in the middle of an item.
                ray.kill(actor)
            if reports:
                yield found
    except ray.exceptions.RayError as error:
        lines = [line for line in str(error).splitlines() if line.strip()]
        raise ClusterError(
            f"the cluster cannot go on ({lines[-1].strip() if lines else type(error).__name__})"
        ) from error
    finally:
        with suppress(ray.exceptions.RayError):
            for actor in (*begun.values(), *at_work.values()):
                ray.kill(actor)
