"""Where tasks run: in processes of this machine, or on the workers of a Dask scheduler (`engine`, `cluster`)."""

from collections.abc import Generator, Iterable

from bridge.batch.engine import Result, Settings, Task, execute_here


def execute(
    tasks: Iterable[Task], *, jobs: int = 1, scheduler: str | None = None, settings: Settings | None = None
) -> Generator[Result, None, None]:
    """Yield the result of every task as it is done; `tasks` is consumed as workers become free.

    jobs: worker processes on this machine; scheduler: address of a running Dask scheduler, whose workers are used
    instead. Errors: BatchError when no process can begin its work, or the scheduler cannot be reached or is lost.
    """
    settings = settings or Settings()
    if scheduler is None:
        yield from execute_here(tasks, jobs=jobs, settings=settings)
    else:
        from bridge.batch.cluster import execute_on_dask  # imports distributed: a second that nobody else need wait

        yield from execute_on_dask(tasks, scheduler=scheduler, settings=settings)
