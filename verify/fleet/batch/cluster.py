"""A worker pool on a Dask cluster that runs already."""

from collections import Counter, deque
from collections.abc import Iterator
from typing import Any

from verify.core.version import __version__
from verify.errors import InputError
from verify.fleet.batch.finding import cluster_package
from verify.fleet.batch.records import MAX_ATTEMPTS, Task, WorkerDied, perform

CONNECT_TIMEOUT = 30  # s, for a scheduler to answer and a worker to be there
TASKS_PER_THREAD = 2  # tasks under way a thread: the next is there when one is done


class Cluster:
    """Workers behind a scheduler at an address such as `tcp://10.0.0.1:8786`.

    Raises:
        InputError: nobody answers there, no worker has come, or one runs another version.
    """

    def __init__(self, address: str) -> None:
        distributed = cluster_package("distributed", "--scheduler")
        try:
            self._client = distributed.Client(
                address, timeout=CONNECT_TIMEOUT, set_as_default=False
            )
        except (OSError, ValueError, TypeError) as error:
            raise _cluster_error(address, f"does not answer ({error})") from error
        try:
            self._client.wait_for_workers(1, timeout=CONNECT_TIMEOUT)
        except (TimeoutError, distributed.TimeoutError) as error:
            self.close()
            raise _cluster_error(address, f"has no worker within {CONNECT_TIMEOUT} s") from error
        self._require_version(address)

    @property
    def workers(self) -> int:
        """Count the threads of its workers."""
        return max(int(sum(self._client.nthreads().values())), 1)

    @property
    def page(self) -> str | None:
        """Dask's own page about the work; None where the scheduler serves none."""
        serves = "dashboard" in self._client.scheduler_info().get("services", {})
        return str(self._client.dashboard_link) if serves else None

    def ready(self) -> None:
        """Wait for nobody: a worker was there before this pool."""

    def run(self, tasks: deque[Task]) -> Iterator[tuple[Task, Any]]:
        """Perform tasks as `ProcessPool` does; the scheduler replaces a worker that dies."""
        distributed = cluster_package("distributed", "--scheduler")
        done = distributed.as_completed(loop=self._client.loop, raise_errors=False)
        under_way: dict[str, Task] = {}
        died: Counter[int] = Counter()
        while tasks or under_way:
            self._hand_out(tasks, under_way, done)
            future = next(done)
            task = under_way.pop(future.key)
            error = future.exception() if future.status == "error" else None
            lost = future.status in ("cancelled", "lost")
            if lost:  # the scheduler itself was restarted: it knows nothing of it any more
                died[id(task)] += 1
                if died[id(task)] < MAX_ATTEMPTS:
                    tasks.appendleft(task)
                    continue
            if error is not None and not isinstance(error, distributed.KilledWorker):
                raise error
            outcome = WorkerDied() if lost or error is not None else future.result()
            died.pop(id(task), None)
            future.release()
            yield task, outcome

    def close(self) -> None:
        """Leave the cluster as it was; what is under way is dropped."""
        self._client.close()

    def _hand_out(self, tasks: deque[Task], under_way: dict[str, Task], done: Any) -> None:
        while tasks and len(under_way) < TASKS_PER_THREAD * self.workers:
            task = tasks.popleft()
            future = self._client.submit(perform, task, pure=False)
            under_way[future.key] = task
            done.add(future)

    def _require_version(self, address: str) -> None:
        try:
            versions = set(self._client.run(worker_version).values())
        except Exception as error:  # whatever goes wrong there is pickled and raised here
            self.close()
            raise _cluster_error(address, f"its workers have no verify ({error})") from error
        if versions != {__version__}:
            self.close()
            others = ", ".join(sorted(versions - {__version__}))
            raise _cluster_error(address, f"its workers run verify {others}, this is {__version__}")


def worker_version() -> str:
    """Tell a worker's version of the program."""
    return __version__


def _cluster_error(address: str, found: str) -> InputError:
    expected = "a Dask scheduler with workers that have this version of verify is expected"
    return InputError(f"--scheduler {address}", found, expected, "Start one, or leave it out.")
