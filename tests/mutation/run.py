"""Makes mutants of the environment's modules and counts how many of them the tests notice.

    python tests/mutation/run.py                                    # every mutant of every room
    python tests/mutation/run.py engine reward --sample 60 --seed 0  # 60 of each room, drawn at random

A mutant is the source with one place changed (``operators``). It is caught when a test fails or does not end in time,
and survives when all tests of its room pass (``rooms.toml``). ``equivalents.toml`` lists
changes that no test can notice, with a reason each; they are counted apart. The tests must pass on the unchanged tree
first, and everything runs in copies: the tree itself is not touched.

Exit status: 0 if every room's share caught is at least ``--least``, 1 if not, 2 if the run cannot be made.
"""

from __future__ import annotations

import argparse
import difflib
import json
import os
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from operators import Mutant, mutants_of
from rooms import Equivalent, Room, all_mutants, preloaded, read_equivalents, read_rooms, stale
from trial import OLD_S, Trial, begin, copy_tree, preload

HERE = Path(__file__).parent
BASELINE_LIMIT_S = 1800.0


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant: "caught", "timed out", "survived" or "equivalent"."""

    room: str
    mutant: Mutant
    what: str
    test: str
    seconds: float


def main() -> int:
    args = _arguments()
    root = args.root.resolve()
    try:
        rooms = read_rooms(args.rooms, root, args.names)
        known = read_equivalents(args.equivalents)
        gone = stale(root, known)
        if gone:
            raise ValueError(f"{args.equivalents.name}: {gone[0].module} has no change to {gone[0].after!r}; remove it")
        chosen = {room.name: _chosen(args, room, all_mutants(root, room)) for room in rooms}
        preload(preloaded(args.rooms))
        with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
            copies = [Path(folder) / f"copy{i}" for i in range(args.jobs)]
            limits_s = _baseline(root, copies, rooms, args.grace)
            outcomes: list[Outcome] = []
            try:
                for room in rooms:
                    for outcome in _outcomes(copies, room, chosen[room.name], known, limits_s[room.name]):
                        outcomes.append(outcome)  # one by one, so that an interrupt keeps what is done
            except KeyboardInterrupt:
                print("mutation run: interrupted; the table is of what was tried until now", file=sys.stderr)
    except ValueError as error:
        print(f"mutation run: {error}", file=sys.stderr)
        return 2
    if args.out:
        _write(args.out, outcomes)
    totals = {
        module: len(mutants_of(module, (root / module).read_bytes())) for room in rooms for module in room.modules
    }
    return _report(rooms, outcomes, totals, args.least)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="room", help="rooms of rooms.toml; all of them by default")
    parser.add_argument("--sample", type=int, help="mutants drawn at random from each room; all by default")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample")
    parser.add_argument("--module", action="append", help="only mutants of this module, a path; may be given again")
    parser.add_argument("--survivors", type=Path, help="only those that survived in an earlier run's --out file")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="trials at once; one for each core")
    parser.add_argument(
        "--grace", type=float, default=60.0, help="seconds a trial has beyond five times the tests' own"
    )
    parser.add_argument("--least", type=float, default=90.0, help="share that must be caught in each room, %%")
    parser.add_argument("--out", type=Path, help="write every mutant's outcome to this JSON file")
    parser.add_argument("--root", type=Path, default=HERE.parents[1], help="the tree, this repository by default")
    parser.add_argument("--rooms", type=Path, default=HERE / "rooms.toml", help="modules and tests of each room")
    parser.add_argument("--equivalents", type=Path, default=HERE / "equivalents.toml", help="changes without effect")
    args = parser.parse_args()
    if args.jobs < 1 or (args.sample is not None and args.sample < 1):
        parser.error("--jobs and --sample must be at least 1")
    return args


def _chosen(args: argparse.Namespace, room: Room, mutants: list[Mutant]) -> list[Mutant]:
    if args.module:
        mutants = [m for m in mutants if m.module in args.module]
    if args.survivors:
        earlier = {(e["module"], e["before"], e["after"]) for e in json.loads(args.survivors.read_text())
                   if e["what"] == "survived"}  # fmt: skip
        mutants = [m for m in mutants if (m.module, m.before, m.after) in earlier]
    if args.sample is not None and args.sample < len(mutants):
        mutants = random.Random(f"{args.seed} {room.name}").sample(mutants, args.sample)
    return mutants


def _baseline(root: Path, copies: list[Path], rooms: list[Room], grace_s: float) -> dict[str, float]:
    """Make the copies and run each room's tests in the first; the time limit of a room's mutants, s.

    ValueError if a test fails on the unchanged tree.
    """
    copy_tree(root, copies[0])
    limits_s = {}
    for room in rooms:
        print(f"{room.name}: the tests on the unchanged tree", file=sys.stderr)
        trial = begin(copies[0], room.all_asked(copies[0]), BASELINE_LIMIT_S, None, first=True)
        (ended,) = _each_end([trial])
        if ended != "passed":
            raise ValueError(f"room {room.name!r}: on the unchanged tree the tests {ended}: {trial.failure()}")
        # Other work on the machine, or kernels compiled anew, must not look like a mutant that does not end.
        limits_s[room.name] = grace_s + 5.0 * trial.spent_s
    for copy in copies[1:]:
        shutil.copytree(copies[0], copy, symlinks=True)
    return limits_s


def _each_end(trials: list[Trial]) -> Iterator[str]:
    for trial in trials:
        try:
            while (ended := trial.ended()) is None:
                time.sleep(0.05)
        finally:
            trial.kill()
        yield ended


def _outcomes(
    copies: list[Path], room: Room, mutants: list[Mutant], known: list[Equivalent], limit_s: float
) -> Iterator[Outcome]:
    """Yield the outcome of each mutant; those known to be equivalent are not tried."""
    rest = []
    for mutant in mutants:
        if any(entry.is_of(mutant) for entry in known):
            yield Outcome(room.name, mutant, "equivalent", "", 0.0)
        else:
            rest.append(mutant)
    yield from _judged(copies, room, rest, limit_s)


def _judged(copies: list[Path], room: Room, mutants: list[Mutant], limit_s: float) -> Iterator[Outcome]:
    """Try each mutant in whichever copy is free."""
    waiting, free = list(mutants), list(copies)
    running: dict[Path, tuple[Mutant, Trial, bytes]] = {}
    done = 0
    try:
        while waiting or running:
            while waiting and free:
                copy, mutant = free.pop(), waiting.pop(0)
                whole = (copy / mutant.module).read_bytes()
                (copy / mutant.module).write_bytes(mutant.source)
                cache = copy.with_name(copy.name + "-kernels") if room.private_cache else None
                running[copy] = mutant, begin(copy, room.asked(copy, mutant.module), limit_s, cache), whole
            time.sleep(0.05)
            for copy, (mutant, trial, whole) in list(running.items()):
                ended = trial.ended()
                if ended is None:
                    continue
                del running[copy]
                _restore(copy, mutant.module, whole)
                free.append(copy)
                done += 1
                what = {"passed": "survived", "failed": "caught"}.get(ended, ended)
                test = trial.failure() if what == "caught" else ""
                print(f"{room.name} {done}/{len(mutants)} {what} {mutant.module}:{mutant.line}", file=sys.stderr)
                yield Outcome(room.name, mutant, what, test, trial.spent_s)
    finally:
        for _, trial, _ in running.values():
            trial.kill()


def _restore(copy: Path, module: str, whole: bytes) -> None:
    target = copy / module
    target.write_bytes(whole)
    os.utime(target, (OLD_S, OLD_S))
    shutil.rmtree(copy.with_name(copy.name + "-kernels"), ignore_errors=True)


def _write(path: Path, outcomes: list[Outcome]) -> None:
    rows = [
        {
            "room": o.room, "module": o.mutant.module, "line": o.mutant.line, "before": o.mutant.before,
            "after": o.mutant.after, "what": o.what, "test": o.test, "seconds": round(o.seconds, 1),
        }
        for o in outcomes
    ]  # fmt: skip
    path.write_text(json.dumps(rows, indent=1) + "\n")


HEADS = ("module", "mutants", "tried", "equivalent", "caught", "timed out", "survived", "share", "95 % interval")


def _report(rooms: list[Room], outcomes: list[Outcome], totals: dict[str, int], least: float) -> int:
    """Print the table and the survivors; 1 if a room has too few caught, else 0."""
    rows: list[tuple[str, ...]] = [HEADS]
    poor = []
    for room in rooms:
        own = [o for o in outcomes if o.room == room.name]
        for module in room.modules:
            theirs = [o for o in own if o.mutant.module == module]
            if theirs:
                rows.append(_row(module, totals[module], theirs))
        if own:
            rows.append(_row(room.name.upper(), sum(totals[module] for module in room.modules), own))
            judged = [o for o in own if o.what != "equivalent"]
            if 100.0 * sum(o.what != "survived" for o in judged) < least * len(judged):
                poor.append(room.name)
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADS))]
    for row in rows:
        print(row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True)), sep="  ")
    for o in outcomes:
        if o.what == "survived":
            name = f"{o.mutant.module}:{o.mutant.line}"
            print(
                "", *difflib.unified_diff([o.mutant.before], [o.mutant.after], name, "survived", lineterm=""), sep="\n"
            )
    for name in poor:
        print(f"\n{name}: fewer than {least:g} % are caught")
    return 1 if poor else 0


def _row(name: str, total: int, outcomes: list[Outcome]) -> tuple[str, ...]:
    """A line of the table; the interval is Wilson's, of all mutants from those tried."""
    from scipy.stats import binomtest

    counts = [sum(o.what == what for o in outcomes) for what in ("equivalent", "caught", "timed out", "survived")]
    judged, noticed = sum(counts[1:]), counts[1] + counts[2]
    share = interval = ""
    if judged:
        bounds = binomtest(noticed, judged).proportion_ci(method="wilson")
        share, interval = f"{100 * noticed / judged:.1f} %", f"{100 * bounds.low:.0f} to {100 * bounds.high:.0f} %"
    return name, str(total), str(len(outcomes)), *map(str, counts), share, interval


if __name__ == "__main__":
    sys.exit(main())
