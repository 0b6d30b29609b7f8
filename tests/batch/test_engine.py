"""Work on this machine without Dask: every task once, faults cost their item, and no process is left behind."""

import contextlib

import psutil
from processes import still_running

from bridge.batch.engine import Settings, Task, execute_here

TASKS = [Task(f"t{k}", "faults:numbers", "", (10 * k, 10 * k + 1)) for k in range(6)]


def values(results: object) -> dict[str, list[object]]:
    return {
        result.task.key: [outcome.value[1] if outcome.value else outcome.failure.kind for outcome in result.outcomes]
        for result in results  # type: ignore[attr-defined]
    }


def test_two_processes_do_every_task_once_as_one_does() -> None:
    expected = {task.key: list(task.items) for task in TASKS}
    assert values(execute_here(TASKS, jobs=1)) == expected
    assert values(execute_here(TASKS, jobs=2)) == expected


def test_a_crash_costs_its_item_only() -> None:
    tasks = [*TASKS, Task("bad", "faults:numbers", "", (1, "segfault", 2))]
    assert values(execute_here(tasks, jobs=2))["bad"] == [1, "crashed", 2]


def test_processes_end_when_the_results_are_not_wanted_any_more() -> None:
    before = set(psutil.Process().children(recursive=True))  # other tests leave a resource tracker running
    tasks = [TASKS[0], *(Task(f"hang{k}", "faults:numbers", "", ("hang", 1)) for k in range(4))]
    with contextlib.closing(execute_here(tasks, jobs=2, settings=Settings(timeout_s=60.0))) as results:
        assert next(results).task.key == "t0"
        children = [child for child in psutil.Process().children(recursive=True) if child not in before]
        assert len(children) == 2
    assert still_running(children, timeout_s=10) == []
