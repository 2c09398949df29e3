"""Print the README's table of results from the benchmark's pages and the policies' cards: `python docs/headline.py`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))
from headroom import headroom

SHOWN = ("ieee123", "ieee33-weak", "mixed", "ieee34-3ph", "smoothing", "routing")


def table() -> str:
    """The table, as Markdown."""
    lines = ["| scenario | no control | tuned droop | best policy that ships | hindsight |", "|---|---|---|---|---|"]
    for preset in SHOWN:
        rows = {row.what: row for row in headroom(preset).rows}
        policy = next(row for what, row in rows.items() if what.startswith(f"`{preset}-"))
        best = rows.get("hindsight") or rows["best known"]
        cells = [f"`{preset}`", rows["`none`"].j, rows["`droop-tuned`"].j, f"{policy.j} ({policy.score.split()[0]})"]
        lines.append("| " + " | ".join([*cells, best.j if "hindsight" in rows else f"{best.j} (best known)"]) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
