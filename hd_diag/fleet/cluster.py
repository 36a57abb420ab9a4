"""Workers of a Dask scheduler; each worker reads bags on its own machine."""

from __future__ import annotations

import logging
import time
import uuid
from collections.abc import Callable, Mapping
from typing import Any

from hd_diag.fleet import FleetError
from hd_diag.process_pool import Failure

# How long to wait [s]
_CONNECT = 10.0  # for the scheduler
_GATHER = 10.0  # for a result
_WORKERS = 60.0  # for a first worker


class ClusterPool:
    """The worker processes of a Dask scheduler, which may come and go; each does one task at a time.

    A task is pinned to its worker, so that the task of a dead worker is known. Raises FleetError if there is
    no scheduler at the address, or Dask is not installed.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client
        except ImportError as error:
            raise FleetError(f"--scheduler needs Dask: pip install 'hd_diag[cluster]' ({error})") from error
        # Dask would report every lost worker; the run reports what matters.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self._address = address
        try:
            self._client = Client(address, timeout=_CONNECT, set_as_default=False)
        except Exception as error:  # a wrong address raises several kinds, some without text
            wanted = "an address is like tcp://host:8786"
            raise FleetError(f"no Dask scheduler at {address}: {error}; {wanted}") from error
        self._seen = time.monotonic()

    def workers(self) -> list[str]:
        """Addresses of the present workers."""
        try:
            workers = list(self._client.nthreads())
        except (OSError, TimeoutError, ValueError, RuntimeError) as error:
            raise self._gone() from error
        now = time.monotonic()
        self._seen = now if workers else self._seen
        if now - self._seen > _WORKERS:
            raise FleetError(f"the scheduler at {self._address} has had no worker for {_WORKERS:.0f} s")
        return workers

    def send(self, worker: str, function: Callable[[Any], Any], item: Any) -> Any:
        """Give a worker a task."""
        key = f"hd_diag-{uuid.uuid4()}"
        return self._client.submit(function, item, workers=[worker], key=key, pure=False)

    def done(self, at_work: Mapping[Any, str], patience: float) -> list[tuple[Any, Any]]:
        """Tasks that have ended, with their outcomes."""
        if not at_work:
            time.sleep(patience)
            return []
        self._await(list(at_work), patience)
        workers = self.workers()
        outcomes = []
        for future, worker in at_work.items():
            outcome = self._outcome(future, worker, worker in workers)
            if outcome is not None:
                future.cancel()
                outcomes.append((future, outcome))
        return outcomes

    def _await(self, futures: list[Any], patience: float) -> None:
        from distributed import wait

        try:
            wait(futures, timeout=patience, return_when="FIRST_COMPLETED")
        except TimeoutError:
            return
        except Exception as error:
            # Lost futures show in their state; any other error means that the scheduler is gone.
            if self._client.status != "running":
                raise self._gone() from error

    def _outcome(self, future: Any, worker: str, alive: bool) -> Any:
        """Result or `Failure`; None while the task runs."""
        from distributed import KilledWorker

        gone = Failure(f"{worker} is gone", died=True)
        if future.status == "finished":
            try:
                return future.result(timeout=_GATHER)
            except Exception as error:  # Dask raises many kinds if a worker died with the result
                return Failure(f"{worker}: {error}", died=True)
        if future.status == "error":
            raised = future.exception(timeout=_GATHER)
            if isinstance(raised, ImportError):
                raise FleetError(f"worker {worker} cannot import what it needs: {raised}")
            return gone if isinstance(raised, KilledWorker) else Failure(f"{type(raised).__name__}: {raised}")
        return gone if future.status in ("cancelled", "lost") or not alive else None

    def _gone(self) -> FleetError:
        return FleetError(f"the scheduler at {self._address} is gone")

    def __enter__(self) -> ClusterPool:
        return self

    def __exit__(self, *reason: object) -> None:
        self._client.close(timeout=_GATHER)  # this also ends the running tasks
