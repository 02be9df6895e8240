"""The long run: `PYTHONPATH=tests python -m fuzz [--mutations N] [--processes P] [--targets NAME ...]`; `--only N` repeats one mutation.

Each worker is a process of its own, so that a crash of a native library is seen and ends nothing else. Prints a table, keeps the files of
each fault under --keep, and exits with 1 if there was one.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

MEMORY = 3 << 30  # [bytes] of address space that a mutation may take beyond what the process has after the valid files were used
_BATCH = 500  # mutations of one process
_STUCK = 90  # [s] without progress after which a worker counts as hanging in native code


def main() -> int:
    """Returns the exit status."""
    from fuzz.targets import TARGETS

    parser = argparse.ArgumentParser(prog="fuzz", description=__doc__)
    parser.add_argument("--mutations", type=int, default=200_000, help="of all targets together")
    parser.add_argument("--first", type=int, default=0, help="number of the first mutation of each target")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--targets", nargs="*", default=list(TARGETS))
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "fuzz-faults")
    parser.add_argument("--only", type=int, help="one mutation, with its traceback")
    parser.add_argument("--worker", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        target, first, count, progress = options.worker
        work(target, int(first), int(count), Path(progress), options.keep)
        return 0
    if options.only is not None:
        return repeat(options.targets[0], options.only)
    shares = {name: TARGETS[name].share for name in options.targets}
    counts = {name: max(1, round(options.mutations * share / sum(shares.values()))) for name, share in shares.items()}
    batches = [
        (name, options.first + start, min(_BATCH, count - start)) for name, count in counts.items() for start in range(0, count, _BATCH)
    ]
    batches.sort(key=lambda batch: batch[1])  # all targets' first mutations first
    totals: dict[str, Counter[str]] = {name: Counter() for name in options.targets}
    places: Counter[str] = Counter()
    start = time.monotonic()
    with ThreadPoolExecutor(options.processes) as pool:
        for (name, _, _), (tally, faults) in zip(batches, pool.map(lambda batch: run_worker(*batch, options.keep), batches)):
            totals[name] += tally
            for fault in faults:
                places[f"{name}: {fault[1].rsplit(' @ ', 1)[-1]} {fault[1].split(':')[0]}"] += 1
                print(f"{name} --only {fault[0]}: {fault[1]}", flush=True)
    print(table(totals), f"{sum(sum(tally.values()) for tally in totals.values())} mutations in {time.monotonic() - start:.0f} s", sep="\n")
    for place, count in places.most_common():
        print(f"{count:5d} x {place}")
    return int(any(tally["fault"] or tally["hang"] or tally["crash"] for tally in totals.values()))


def run_worker(name: str, first: int, count: int, keep: Path) -> tuple[Counter[str], list[tuple[int, str]]]:
    """The outcomes of mutations first ... first + count - 1, and the faults among them. After a crash a new process goes on behind it."""
    tally: Counter[str] = Counter()
    faults: list[tuple[int, str]] = []
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as folder:
        while count > 0:
            progress = Path(folder) / "progress"
            progress.write_text("")
            python = [sys.executable, "-X", "faulthandler", "-m", "fuzz"]
            task = ["--keep", str(keep), "--worker", name, str(first), str(count), str(progress)]
            worker = subprocess.Popen([*python, *task], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
            stuck, last = 0.0, ""
            while True:
                try:
                    _, errors = worker.communicate(timeout=5)
                    break
                except subprocess.TimeoutExpired:
                    now = progress.read_text()
                    stuck = stuck + 5 if now == last else 0.0
                    last = now
                    if stuck >= _STUCK:
                        worker.kill()
            lines = [json.loads(line) for line in progress.read_text().splitlines() if line.endswith("]")]
            done = [line for line in lines if len(line) == 3]
            tally.update(outcome for _, outcome, _ in done)
            faults += [(number, message) for number, outcome, message in done if outcome in ("fault", "hang")]
            if worker.returncode == 0:
                break
            failed = lines[-1][0] if lines else first
            kind = "hang" if stuck >= _STUCK else "crash"
            tally[kind] += 1
            faults.append((failed, f"{kind}: {' '.join(errors.split())[-400:]} @ native code, status {worker.returncode}"))
            count -= failed + 1 - first
            first = failed + 1
    return tally, faults


def work(name: str, first: int, count: int, progress: Path, keep: Path) -> None:
    """Writes a line before and a line after each mutation."""
    from fuzz.campaign import FAULT, HANG, Campaign, quiet
    from fuzz.targets import TARGETS

    with quiet(), progress.open("a") as file:
        campaign = Campaign(TARGETS[name], progress.parent / "files")
        campaign.judge(first)  # so that what is loaded at first use is loaded
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        for number in range(first, first + count):
            file.write(json.dumps([number]) + "\n")
            file.flush()
            outcome, message = campaign.judge(number)
            file.write(json.dumps([number, outcome, message]) + "\n")
            if outcome in (FAULT, HANG):
                campaign.keep(number, keep / f"{name} {number}".replace(" ", "-").replace("/", "-"))


def repeat(name: str, number: int) -> int:
    """Mutation `number` of a target, as a traceback if it is one."""
    from fuzz.campaign import Campaign
    from fuzz.targets import TARGETS

    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        campaign = Campaign(TARGETS[name], Path(folder))
        outcome, message = campaign.judge(number)
        print(outcome, message)
    return int(outcome not in ("accepted", "refused"))


def table(totals: dict[str, Counter[str]]) -> str:
    """The outcomes by target."""
    rows = ["| target | mutations | refused | accepted | faults | hangs | crashes |", "|---|---|---|---|---|---|---|"]
    total: Counter[str] = Counter()
    for name, tally in [*totals.items(), ("all", total)]:
        total += tally if name != "all" else Counter()
        numbers = [sum(tally.values()), *(tally[kind] for kind in ("refused", "accepted", "fault", "hang", "crash"))]
        rows.append(f"| {name} | {' | '.join(map(str, numbers))} |")
    return "\n".join(rows)


if __name__ == "__main__":
    sys.exit(main())
