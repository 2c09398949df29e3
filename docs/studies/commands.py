"""The table of the commands of this folder, as ``dcgrid_command.command_table`` has those of ``dcgrid``."""

from functools import partial

from dcgrid_command.group import Entry, Group
from dcgrid_env.cli.main import main as command_line

PROG = "python -m docs.studies"
_entry = partial(Entry, package="docs.studies")
COMMANDS = Group(
    "Make the data, policies and studies that this project publishes.",
    {
        "Bundled data": {
            "best-known": _entry(
                "Search for the least cost where no linear program applies.",
                "best_known.best_known_values:BestKnownValues",
            ),
            "rescore": _entry("Score bundled policies again and write their cards.", "publishing.rescore:Rescore"),
            "benchmark-data": _entry(
                "Write the data file of a benchmark's page.", "publishing.benchmark_data:PublishBenchmark"
            ),
            "leaderboard": _entry("Check that verified folders can be listed.", "publishing.leaderboard:Leaderboard"),
            "entries": _entry(
                "Make our leaderboard entries and score them in a round.", "publishing.leaderboard:LeaderboardEntries"
            ),
        },
        "Publish a policy": {
            "ship": _entry("Score training runs with different seeds; save the best.", "publishing.shipping:Ship"),
            "export-hub": _entry(
                "Write a policy as a folder for the Hugging Face hub.", "publishing.hub_export:ExportHub"
            ),
        },
        "Studies": {
            "algorithms": _entry(
                "Print tables of algorithms and their profiles.", "learning.algorithms:AlgorithmTables"
            ),
            "ablate": _entry("Train a policy without some of its parts and score each.", "learning.ablate:Ablate"),
            "circuits": _entry("Import every OpenDSS circuit in a folder.", "grids.circuits:Circuits"),
            "corpus": _entry("Compare imports of public grids with their programs.", "grids.corpus:Corpus"),
            "first-training": _entry(
                "Train PPO by the README's lines on presets.", "learning.first_training:FirstTraining"
            ),
            "fit-paper": _entry("Search for the values that the paper does not state.", "paper.fit_paper:FitPaper"),
            "generalise": _entry(
                "Train on all scenarios but one and score on that one.", "learning.generalise:Generalise"
            ),
            "libraries": _entry("Train unmodified libraries and print their table.", "learning.libraries:LibraryTable"),
            "pareto": _entry("Draw voltage against delay of policies with delay limits.", "learning.pareto:Pareto"),
            "reproduction": _entry(
                "Write the page on the paper's study, with its figures.", "paper.reproduction_page:ReproductionPage"
            ),
            "reproduction-3ph": _entry(
                "Compare the paper's study on two feeders, as a page.", "paper.reproduction_page:FeederPage"
            ),
            "random-feeders": _entry(
                "Compare random feeders with published ones.", "grids.random_feeders:RandomFeederTable"
            ),
            "sags": _entry("Compare controllers during a recorded sequence of sags.", "laws.sag_study:Sags"),
            "transfer": _entry("Score bundled policies on other presets.", "learning.transfer:Transfer"),
            "unseen-feeders": _entry(
                "Score controllers on feeders they never saw.", "learning.unseen_feeders:UnseenFeeders"
            ),
        },
        "Speed": {
            "roofline": _entry("Compare two batched power flows with what one core can do.", "speed.roofline:Roofline"),
            "soak": _entry("Run environments for long and look at memory and speed.", "speed.soak:Soak"),
            "speed": _entry("Measure environments, power flows and other libraries.", "speed.rates:Speed"),
            "speed-sizes": _entry("Measure feeders of 100 to 100,000 buses.", "speed.size_table:SpeedSizes"),
            "speed-training": _entry(
                "Measure a training by gradients through the grid.", "speed.training_rates:TrainingSpeed"
            ),
        },
    },
)


def main(args: list[str] | None = None) -> None:
    """Run a command of the table."""
    command_line(args, COMMANDS, PROG)
