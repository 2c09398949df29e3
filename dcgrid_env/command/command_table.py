"""Table of commands: section, summary and class of every command."""

from dcgrid_command.group import Entry, Group

TRACEBACK = "--traceback"
"""Option of every command; it may be anywhere on the command line."""
VERSION = "--version"
_IMPORT = Group(
    "Read feeders from files of other programs.",
    {
        "Formats": {
            "opendss": Entry(
                "Read a three-phase feeder from an OpenDSS master file.", "apps.importers.opendss_import:ImportOpenDss"
            ),
            "gridlabd": Entry(
                "Read a three-phase feeder from a GridLAB-D model.", "apps.importers.opendss_import:ImportGridlabd"
            ),
            "pandapower": Entry(
                "Read a balanced feeder from a pandapower net.", "apps.importers.grid_import:ImportPandapower"
            ),
            "matpower": Entry(
                "Read a balanced feeder from a MATPOWER case file.", "apps.importers.grid_import:ImportMatpower"
            ),
            "power-grid-model": Entry(
                "Read a balanced feeder from a power-grid-model JSON file.",
                "apps.importers.grid_import:ImportPowerGridModel",
            ),
        }
    },
)
_EXPORT = Group(
    "Write feeders as files of other programs.",
    {
        "Formats": {
            "pandapower": Entry(
                "Write a balanced feeder as the JSON of a pandapower net.",
                "apps.importers.grid_export:ExportPandapower",
            ),
            "matpower": Entry(
                "Write a balanced feeder as a MATPOWER case file.", "apps.importers.grid_export:ExportMatpower"
            ),
            "power-grid-model": Entry(
                "Write a balanced feeder as power-grid-model JSON.", "apps.importers.grid_export:ExportPowerGridModel"
            ),
        }
    },
)
_ALGORITHM = "agents.train_command:Algorithm"
_TRAIN = Group(
    "Train a policy with one of several algorithms.",
    {
        "Algorithms": {
            "ppo": Entry("PPO (Stable-Baselines3).", _ALGORITHM),
            "sac": Entry("Soft actor-critic (Stable-Baselines3).", _ALGORITHM),
            "td3": Entry("Twin delayed DDPG (Stable-Baselines3).", _ALGORITHM),
            "cem": Entry("Cross-entropy method: random search without gradients.", _ALGORITHM),
            "affine": Entry("Affine correction of the droop, found by random search.", _ALGORITHM),
            "analytic": Entry("Policy gradients through the power flow.", _ALGORITHM),
            "safe": Entry("Policy gradients with bounded controller gains.", _ALGORITHM),
            "carry-over": Entry("Learned corrections to the model-aided law.", _ALGORITHM),
        }
    },
)
_TRACES = Group(
    "Fetch, check, show and record power traces.",
    {
        "Commands": {
            "check": Entry("Check a recording of power and report how it would be used.", "cli.traces:CheckRecording"),
            "fetch": Entry("Download a published recording and verify it.", "cli.traces:Fetch"),
            "show": Entry("Plot a trace: power, ramps, spectrum and duration curve.", "cli.traces:Show"),
            "record": Entry("Record the power of this machine's GPUs through NVML.", "cli.traces:Record"),
        }
    },
)
COMMANDS = Group(
    "Voltage control of distribution feeders with AI data centres.",
    {
        "Get started": {
            "run": Entry("Run controllers on the same episodes and compare them.", "cli.run:Run"),
            "list": Entry("List scenarios, feeders, controllers, traces and fields.", "cli.listing:List"),
            "replay": Entry("Show an episode in the browser, step by step.", "cli.replay:Replay"),
        },
        "Your feeder": {
            "import": _IMPORT,
            "check": Entry(
                "Check in a minute whether a scenario is worth learning on.", "baselines.check_command:Check"
            ),
            "capacity": Entry(
                "Find the largest data centre that each bus can carry.", "apps.hosting.capacity_command:Capacity"
            ),
            "study": Entry(
                "Answer a connection request with one report.",
                "apps.hosting.connection_study.study_command:ConnectionStudy",
            ),
            "export": _EXPORT,
        },
        "Train and evaluate": {
            "train": _TRAIN,
            "evaluate": Entry("Score a policy on held-out episodes.", "agents.evaluate_command:Evaluate"),
            "tune": Entry("Tune control laws on the validation split of scenarios.", "baselines.tune_command:Tune"),
            "hindsight": Entry(
                "Solve episodes with perfect foresight and store the costs.", "baselines.hindsight_command:Hindsight"
            ),
            "benchmark": Entry(
                "Score controllers on the test split of scenarios.", "apps.benchmark.benchmark_command:Benchmark"
            ),
            "dataset": Entry(
                "Write episodes as a Minari data set for offline learning.", "agents.dataset_command:Dataset"
            ),
        },
        "Publish": {
            "submit": Entry("Create an entry for the leaderboard.", "apps.leaderboard.submit_command:Submit"),
            "verify": Entry(
                "Score leaderboard entries in a round and write reports.", "apps.leaderboard.verify_command:Verify"
            ),
            "export-sb3": Entry(
                "Convert a Stable-Baselines3 model into a policy file.", "agents.export_sb3_command:ExportSb3"
            ),
            "reproduce": Entry(
                "Repeat the paper's study (Chen and Zhang, arXiv 2507.06416).",
                "apps.reproduction.reproduce_command:Reproduce",
            ),
        },
        "Data": {"traces": _TRACES},
    },
    {VERSION: "Show the version and exit.", TRACEBACK: "Show the traceback of an error, with any command."},
)
