"""The long run: `PYTHONPATH=tests python -m fuzz [--mutations N] [--processes P] [--targets NAME ...]`; `--only N` repeats one mutation.

Each batch is a process of its own, so that a crash of a native library is seen and ends nothing else. Prints a table, keeps the files of
each fault under --keep, and exits with 1 if there was one.
"""

import argparse
import faulthandler
import json
import os
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from fuzz.campaign import ACCEPTED, FAULT, HANG, REFUSED, Campaign, quiet
from fuzz.targets import TARGETS

CRASH = "crash"
MEMORY = 3 << 30  # [bytes] of address space that mutations may take beyond what the process has after its first one
_BATCH = 2000  # mutations of one process
_STUCK = 120  # [s] without progress after which a process counts as hanging in native code
_POLL = 0.2  # [s] between looks at the processes


def main() -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(prog="fuzz", description=__doc__)
    parser.add_argument("--mutations", type=int, default=200_000, help="of all targets together")
    parser.add_argument("--first", type=int, default=0, help="number of the first mutation of each target")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--targets", nargs="*", default=list(TARGETS))
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "fuzz-faults")
    parser.add_argument("--only", type=int, help="one mutation, whose files are kept")
    options = parser.parse_args()
    if options.only is not None:
        return repeat(options.targets[0], options.only, options.keep)
    shares = {name: TARGETS[name].share for name in options.targets}
    counts = {name: max(1, round(options.mutations * share / sum(shares.values()))) for name, share in shares.items()}
    waiting = [
        Batch(name, options.first + start, options.first + min(start + _BATCH, count))
        for start in range(0, max(counts.values()), _BATCH)
        for name, count in counts.items()
        if start < count
    ]
    totals: dict[str, Counter[str]] = {name: Counter() for name in options.targets}
    places: Counter[str] = Counter()
    start = time.monotonic()
    for batch in finished(waiting, options.processes, options.keep):
        for number, outcome, message in batch.outcomes:
            totals[batch.target][outcome] += 1
            if outcome not in (ACCEPTED, REFUSED):
                places[f"{batch.target}: {message.split(':')[0]} @ {message.rsplit(' @ ', 1)[-1]}"] += 1
                print(f"--targets '{batch.target}' --only {number}: {outcome}: {message}", flush=True)
    print(table(totals))
    print(f"{sum(sum(tally.values()) for tally in totals.values())} mutations in {time.monotonic() - start:.0f} s")
    for place, count in places.most_common():
        print(f"{count:6d} x {place}")
    return int(bool(places))


@dataclass
class Batch:
    """Mutations `first` to `end` of a target, of which those before `first` are done."""

    target: str
    first: int
    end: int
    outcomes: list[tuple[int, str, str]] = field(default_factory=list)  # number, outcome, message


@dataclass
class Worker:
    """A process that works at a batch, and its folder with the progress that it writes."""

    batch: Batch
    pid: int
    folder: Path
    seen: int = 0  # [bytes] of its progress
    since: float = field(default_factory=time.monotonic)  # [s] when the progress last grew

    @staticmethod
    def start(batch: Batch, keep: Path) -> "Worker":
        folder = Path(tempfile.mkdtemp(prefix="fuzz-", dir="/dev/shm" if os.path.isdir("/dev/shm") else None))
        (folder / "progress").touch()
        pid = os.fork()  # what is imported once need not be imported by each
        if pid:
            return Worker(batch, pid, folder)
        status = 1
        try:
            work(batch, folder, keep)
            status = 0
        finally:
            os._exit(status)

    def collect(self) -> bool:
        """Takes over the outcomes once the process has ended; returns whether it has. A crash or a hang is one as well."""
        size = (self.folder / "progress").stat().st_size
        if size > self.seen:
            self.seen, self.since = size, time.monotonic()
        stuck = time.monotonic() - self.since > _STUCK
        if stuck:
            os.kill(self.pid, 9)
        done, status = os.waitpid(self.pid, 0 if stuck else os.WNOHANG)
        if not done:
            return False
        lines = [json.loads(line) for line in (self.folder / "progress").read_text().splitlines() if line.endswith("]")]
        self.batch.outcomes += [(number, outcome, message) for number, outcome, message in (line for line in lines if len(line) == 3)]
        if status:
            failed = lines[-1][0] if lines else self.batch.first
            trace = " ".join((self.folder / "errors").read_text().split())[-400:]
            self.batch.outcomes.append((failed, HANG if stuck else CRASH, f"native code: {trace} @ status {status}"))
            self.batch.first = failed + 1
        else:
            self.batch.first = self.batch.end
        shutil.rmtree(self.folder, ignore_errors=True)
        return True


def finished(waiting: list[Batch], processes: int, keep: Path) -> Iterator[Batch]:
    """Works at the batches in so many processes, and yields each when it is done. After a crash a new process goes on behind it."""
    running: list[Worker] = []
    while waiting or running:
        while waiting and len(running) < processes:
            running.append(Worker.start(waiting.pop(0), keep))
        time.sleep(_POLL)
        for worker in [worker for worker in running if worker.collect()]:
            running.remove(worker)
            if worker.batch.first < worker.batch.end:
                waiting.insert(0, worker.batch)
            else:
                yield worker.batch


def work(batch: Batch, folder: Path, keep: Path) -> None:
    """Writes a line before and a line after each mutation."""
    errors = (folder / "errors").open("w")
    os.dup2(errors.fileno(), 1)
    os.dup2(errors.fileno(), 2)
    faulthandler.enable(errors)
    with quiet(), (folder / "progress").open("a") as file:
        campaign = Campaign(TARGETS[batch.target], folder / "files")
        campaign.judge(batch.first)  # so that what is loaded at first use is loaded
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        for number in range(batch.first, batch.end):
            file.write(json.dumps([number]) + "\n")
            file.flush()
            outcome, message = campaign.judge(number)
            file.write(json.dumps([number, outcome, message]) + "\n")
            if outcome in (FAULT, HANG):
                campaign.keep(number, keep / f"{batch.target} {number}".replace(" ", "-"))


def repeat(name: str, number: int, keep: Path) -> int:
    """Mutation `number` of a target; its files are kept."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        campaign = Campaign(TARGETS[name], Path(folder) / "files")
        outcome, message = campaign.judge(number)
        place = keep / f"{name} {number}".replace(" ", "-")
        campaign.keep(number, place)
        print(f"{outcome}: {message}\nfiles: {place}")
    return int(outcome not in (ACCEPTED, REFUSED))


def table(totals: dict[str, Counter[str]]) -> str:
    """The outcomes by target."""
    rows = ["| target | mutations | refused | accepted | faults | hangs | crashes |", "|---|---|---|---|---|---|---|"]
    total = sum(totals.values(), Counter())
    for name, tally in [*totals.items(), ("all", total)]:
        numbers = [sum(tally.values()), *(tally[kind] for kind in (REFUSED, ACCEPTED, FAULT, HANG, CRASH))]
        rows.append(f"| {name} | {' | '.join(map(str, numbers))} |")
    return "\n".join(rows)


if __name__ == "__main__":
    sys.exit(main())
