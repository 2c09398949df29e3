"""Pages on the paper's study: docs/reproduction.md, and docs/reproduction-3ph.md on the feeder with its phases."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dcgrid_env.apps.reproduction.markdown import claims_table, head, table_one
from dcgrid_env.apps.reproduction.markdown_tables import wrapped
from dcgrid_env.apps.reproduction.reproduce_command import HEAD, Reproduce, print_rows, steps
from dcgrid_env.apps.reproduction.study import study
from dcgrid_env.apps.reproduction.study_runs import Runs
from dcgrid_env.core.commands.settings import check_folder
from dcgrid_env.core.commands.terminal import plain_console
from docs.studies.paper import feeder_comparison_markdown as comparison
from docs.studies.paper.feeder_cases import cases
from docs.studies.paper.feeder_comparison import PARTS, compare_feeders
from docs.studies.paper.further_parts import ALL_PARTS, with_further_claims
from docs.studies.paper.markdown_details import render_details
from docs.studies.paper.markdown_guesses import render_guesses
from docs.studies.paper.paper_figures import draw_all
from docs.studies.paper.public_code import render_limits

OTHER_FEEDER = (
    "The feeder is a balanced single-phase equivalent. [The study on the unbalanced feeder](reproduction-3ph.md) "
    "repeats Table I and the claims with phases and regulators. `dcgrid reproduce` repeats Table I and the claims on "
    "the balanced feeder."
)


def render(records: dict[str, Any]) -> str:
    """Return the Markdown page for the records of all parts, with ``meta`` and ``figures`` added to them."""
    parts = [head(records), wrapped(OTHER_FEEDER), claims_table(records), table_one(records), render_limits()]
    return "\n\n".join([*parts, render_guesses(records), render_details(records)]) + "\n"


@dataclass(frozen=True)
class ReproductionPage(Reproduce):
    """Write the page on the paper's study, with its figures.

    In addition to dcgrid reproduce, it has claims on other feeders and on the load, and the settings that come close
    to Table I.
    """

    def run(self) -> None:
        """Run all parts and write page, records and figures; raise ValueError if a setting is invalid."""
        setting, about = self.setting()
        place, console = self.place, plain_console()
        check_folder(self.out)
        runs = Runs(setting)
        with steps(console, len(ALL_PARTS) + 1) as done:
            found = study(runs, lambda part: done(part.replace("_", " ")), place, ALL_PARTS)
            records = about | with_further_claims(found) | {"figures": draw_all(runs, self.out)}
            done("figures")
        print_rows(console, HEAD, [[row[key] for key in HEAD] for row in records["claims"]])
        self.write(console, "reproduction", records, render(records))


@dataclass(frozen=True)
class FeederPage(Reproduce):
    """Compare the paper's study on two feeders, as a page.

    These are the balanced equivalent and the feeder with its phases, with fixed and with acting regulators.
    """

    def run(self) -> None:
        """Run the study on each form of the feeder and write page and records."""
        setting, about = self.setting()
        place, console = self.place, plain_console()
        check_folder(self.out)
        with steps(console, len(PARTS) * len(cases())) as done:
            records = about | compare_feeders(setting, done, place)
        shown = {comparison.causes_table: 6, comparison.table_one_table: 6}
        for make, n in (shown | {comparison.orders_table: 7, comparison.claims_table: 6}).items():
            head, rows = make(records)
            print_rows(console, head[:n], [row[:n] for row in rows])
        self.write(console, "reproduction-3ph", records, comparison.render_comparison(records))
