"""The table of commands: the one place where a command is declared, with its section, its line and its class."""

from dcgrid_command.group import Entry, Group

TRACEBACK = "--traceback"
"""The one option of every command; it may stand anywhere on the line."""
VERSION = "--version"
_IMPORT = Group(
    "Read feeders from the files of other programs.",
    {
        "Formats": {
            "opendss": Entry("Read a three-phase feeder from an OpenDSS master file.", "opendss_import:ImportOpenDss"),
            "pandapower": Entry("Read a balanced feeder from a pandapower net.", "grid_import:ImportPandapower"),
            "matpower": Entry("Read a balanced feeder from a MATPOWER case file.", "grid_import:ImportMatpower"),
            "power-grid-model": Entry(
                "Read a balanced feeder from a power-grid-model JSON file.", "grid_import:ImportPowerGridModel"
            ),
        }
    },
)
_EXPORT = Group(
    "Write feeders as files of other programs.",
    {
        "Formats": {
            "pandapower": Entry(
                "Write a balanced feeder as the JSON of a pandapower net.", "grid_export:ExportPandapower"
            ),
            "matpower": Entry("Write a balanced feeder as a MATPOWER case file.", "grid_export:ExportMatpower"),
            "power-grid-model": Entry(
                "Write a balanced feeder as power-grid-model JSON.", "grid_export:ExportPowerGridModel"
            ),
        }
    },
)
_ALGORITHM = "train:Algorithm"
_TRAIN = Group(
    "Train a policy by an algorithm.",
    {
        "Algorithms": {
            "ppo": Entry("PPO of Stable-Baselines3, shared or centralised.", _ALGORITHM),
            "ppo-counterfactual": Entry("PPO on what each agent's action changed in a step.", _ALGORITHM),
            "sac": Entry("Soft actor-critic of Stable-Baselines3.", _ALGORITHM),
            "td3": Entry("Twin delayed DDPG of Stable-Baselines3.", _ALGORITHM),
            "analytic": Entry("Gradients through the power flow.", _ALGORITHM),
            "safe": Entry("Gradients through the power flow, with bounded gains.", _ALGORITHM),
            "carry-over": Entry("Corrections of the model-aided law, for any feeder.", _ALGORITHM),
        }
    },
)
_TRACES = Group(
    "Fetch, show and record power traces.",
    {
        "Commands": {
            "fetch": Entry("Download a published recording and verify it.", "traces:Fetch"),
            "show": Entry("Plot a trace: power, ramps, spectrum and duration curve.", "traces:Show"),
            "record": Entry("Record the power of this machine's GPUs through NVML.", "traces:Record"),
        }
    },
)
COMMANDS = Group(
    "Voltage control of distribution feeders with AI data centres.",
    {
        "Try": {
            "run": Entry("Run controllers on the same episodes and compare them.", "run:Run"),
            "list": Entry("List scenarios, feeders, controllers, traces and fields.", "listing:List"),
            "replay": Entry("Show an episode in the browser, step by step.", "replay:Replay"),
        },
        "Your grid": {
            "import": _IMPORT,
            "check": Entry("Check in a minute whether a scenario is worth learning on.", "check:Check"),
            "capacity": Entry("Find the largest data centre that each bus can carry.", "capacity:Capacity"),
            "export": _EXPORT,
        },
        "Train": {
            "train": _TRAIN,
            "evaluate": Entry("Score a policy on held-out episodes.", "evaluate:Evaluate"),
            "tune": Entry("Tune control laws on the validation split of scenarios.", "tune:Tune"),
            "tune-agent": Entry("Search an algorithm's settings for a scenario.", "agent_search:TuneAgent"),
            "hindsight": Entry("Solve episodes with perfect foresight and store the costs.", "hindsight:Hindsight"),
            "benchmark": Entry("Score controllers over scenarios on the test split.", "benchmark:Benchmark"),
            "curves": Entry("Draw learning curves of training runs.", "curves:Curves"),
            "dataset": Entry("Write episodes as a Minari data set for offline learning.", "dataset:Dataset"),
        },
        "Publish": {
            "ship": Entry("Score training runs that differ in the seed; write the best.", "ship:Ship"),
            "submit": Entry("Write an entry of the leaderboard.", "submit:Submit"),
            "verify": Entry("Run entries of the leaderboard again and report the scores.", "verify:Verify"),
            "export-sb3": Entry("Convert a Stable-Baselines3 model into a policy file.", "sb3_export:ExportSb3"),
            "reproduce": Entry("Repeat the paper's study (Chen and Zhang, arXiv 2507.06416).", "reproduce:Reproduce"),
        },
        "More": {"traces": _TRACES},
    },
    {VERSION: "Show the version.", TRACEBACK: "With any command, show the traceback of an error."},
)
