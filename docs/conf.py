"""How the site is built: ``python -m sphinx -W -n docs site``, without the network (docs/decisions/0019-site.md)."""

import sys
from pathlib import Path
from typing import Any

from dcgrid_env import __version__

sys.path.insert(0, str(Path(__file__).parent / "extensions"))
sys.path.append(str(Path(__file__).parents[1]))  # docs.studies is not installed

project = "dcgrid"
author = "The dcgrid authors"
copyright = "2026, the dcgrid authors"
release = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "equations",
    "public_names",
    "environment_pages",
    "benchmark_pages",
    "leaderboard_page",
    "api_pages",
    "command_line_page",
]
source_suffix = {".md": "myst-nb", ".myst": "myst-nb", ".ipynb": "myst-nb", ".rst": "restructuredtext"}
root_doc = "index"
exclude_patterns = ["extensions/*"]

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # tests run the notebooks

html_theme = "furo"
html_title = f"dcgrid {release}"
html_logo = "static/logo.svg"
html_static_path = ["static"]
html_extra_path = ["llms.txt"]
html_css_files = ["site.css"]
html_js_files = [("tables.js", {"defer": "defer"})]
html_math_renderer = "svg"
html_theme_options = {"navigation_with_keys": True}
html_copy_source = False
pygments_dark_style = "github-dark"

autodoc_default_options = {"inherited-members": "Env, ParallelEnv, VectorEnv, ABC, tuple, Exception, PickledByFields"}
suppress_warnings = ["ref.python"]  # a word in the text of a type that is the name of several members
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
maximum_signature_line_length = 88
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_custom_sections = ["Problem", "Action space", "Observation space", "Reward", "Starting state", "Episode end"]
napoleon_custom_sections += ["Information"]


def notebook_output_with_the_site(app: Any) -> None:
    """Write what notebooks show into the site's own folder, not into ``jupyter_execute`` in the folder above it."""
    output_folder = str(Path(app.doctreedir) / "jupyter_execute")
    app.env.mystnb_config = app.env.mystnb_config.copy(output_folder=output_folder)


def setup(app: Any) -> None:
    """Connect the functions of this file."""
    app.connect("builder-inited", notebook_output_with_the_site, priority=900)  # after myst_nb has set its own
