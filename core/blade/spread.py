"""Where runs are computed: processes of this machine, or the workers of a Dask cluster.

``local:2`` is a cluster of two processes on this machine, ``tcp://host:8786`` the scheduler of one
that others have started,

    dask scheduler
    dask worker tcp://host:8786 --nworkers 4 --nthreads 1        on each machine

with the same release of bladetwin: a worker whose finite-element code differs is refused, because
runs of two codes do not belong into one archive. Workers need no common folder; a run comes back
to the process that asked for it. Those that join later are used, those that leave are done without.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

from core.errors import BladetwinError, InputError, ModelError
from core.pools import one_thread, process_pool

JOIN_S = 60.0  # until a cluster without workers is given up
Errors = tuple[type[Exception], ...]


@dataclass(frozen=True, slots=True)
class Pool:
    """A place that runs functions.

    submit  starts a call, a `Future` holds its result
    slots   how many calls run at a time, at present
    lost    errors by which one call is lost: its own, or that of a worker that died with it
    broken  errors by which the whole place is
    """

    submit: Callable[..., Future[Any]]
    slots: Callable[[], int]
    lost: Errors = (BladetwinError,)
    broken: Errors = ()


@contextmanager
def spread(
    processes: int, dask: str | None = None, code: Callable[[], str] | None = None
) -> Iterator[Pool]:
    """The place named by `dask`, or so many processes of this machine; closed at the end.

    Where the caller's block raises, calls that run are waited for and others dropped.
    """
    with ExitStack() as held:
        if dask is not None:
            held.enter_context(one_thread())
            yield held.enter_context(_cluster(dask, code))
            return
        own = held.enter_context(process_pool(processes))
        yield Pool(own.submit, lambda: processes, broken=(BrokenProcessPool,))


@contextmanager
def _cluster(address: str, code: Callable[[], str] | None) -> Iterator[Pool]:
    try:
        import distributed
    except ImportError:
        raise InputError("dask", address, "needs Dask", "install bladetwin[dask]") from None
    dask: Any = distributed  # without types
    with ExitStack() as held:
        kind, _, number = address.partition(":")
        if kind == "local" and number.isdigit() and int(number) > 0:
            address = held.enter_context(
                dask.LocalCluster(
                    n_workers=int(number),
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address=None,
                )
            ).scheduler_address
        elif kind not in ("tcp", "tls", "ucx"):
            raise InputError("dask", address, "is no address", "give tcp://host:port or local:2")
        try:
            client = held.enter_context(dask.Client(address, timeout=JOIN_S, set_as_default=False))
            client.wait_for_workers(1, timeout=JOIN_S)
        except (OSError, TimeoutError) as error:
            remedy = "start `dask scheduler` there, and `dask worker ADDRESS --nthreads 1`"
            raise InputError("dask", address, f"has no workers ({error})", remedy) from error
        if code is not None:
            _same_code(client.run(code), code())
        executor = client.get_executor(pure=False)
        slots = lambda: max(1, sum(client.ncores().values()))  # noqa: E731
        try:
            yield Pool(executor.submit, slots, lost=(BladetwinError, dask.KilledWorker))
        finally:
            executor.shutdown(wait=False)


def _same_code(theirs: dict[str, str], ours: str) -> None:
    odd = [worker for worker, digest in theirs.items() if digest != ours]
    if odd:
        raise ModelError(
            f"Dask worker {odd[0]} ({len(odd)} of {len(theirs)}) has other finite-element code: "
            f"{theirs[odd[0]][:12]} there, {ours[:12]} here. Install the same release on it"
        )
