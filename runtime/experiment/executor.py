"""Where work runs: on the cores of this machine, or on a dask or ray cluster, all through joblib."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from runtime.errors import InputError, SessionError

LOCAL = "joblib"
FORMS = f"{LOCAL}, dask://HOST:PORT or ray://HOST:PORT"
_IDLE = 30.0  # [s] after which a worker without work ends
_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of prctl(2)


@contextmanager
def executor(name: str) -> Iterator[bool]:
    """Let joblib run on the executor of that name; yields whether that hands over each result as soon as it is there.

    Raises InputError for what is unknown or not installed, SessionError for a cluster that does not answer.
    """
    scheme, _, place = name.partition("://")
    if name == LOCAL:
        with _local():
            yield True
    elif scheme == "dask" and place:
        with _dask(place):
            yield True
    elif scheme == "ray" and place:
        with _ray(name):
            yield False
    else:
        raise InputError(f"no executor {name!r}; known: {FORMS}")


@contextmanager
def _local() -> Iterator[None]:
    from joblib import parallel_config
    from joblib.externals.loky import get_reusable_executor

    try:
        with parallel_config(
            backend="loky", initializer=_live_and_die_with, initargs=(os.getpid(),), idle_worker_timeout=_IDLE
        ):
            yield
    except BaseException:
        get_reusable_executor(reuse=True).shutdown(wait=True, kill_workers=True)
        raise


def _live_and_die_with(parent: int) -> None:
    """Leave Ctrl-C to the parent, and end when it ends, however it does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_DEATH_SIGNAL, signal.SIGKILL)
        if os.getppid() != parent:  # it has ended already
            os._exit(1)


@contextmanager
def _dask(place: str) -> Iterator[None]:
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--executor dask://... needs dask: pip install 'palpate[dask]'") from None
    from joblib import parallel_config

    try:
        client = Client(f"tcp://{place}", timeout="5s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise SessionError(f"no dask scheduler answers at {place}: {error}") from None
    with client:
        if not client.ncores():
            raise SessionError(f"the dask scheduler at {place} has no workers; start some: dask worker {place}")
        with parallel_config(backend="dask", client=client):
            yield


@contextmanager
def _ray(address: str) -> Iterator[None]:
    try:
        import ray
        from ray.util.joblib import register_ray
    except ImportError:
        raise InputError("--executor ray://... needs ray: pip install 'ray[client]'") from None
    from joblib import parallel_config

    try:
        ray.init(address=address, log_to_driver=False)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise SessionError(f"no ray cluster answers at {address}: {error}") from None
    with contextlib.ExitStack() as closing:
        closing.callback(ray.shutdown)
        register_ray()
        with parallel_config(backend="ray"):
            yield
