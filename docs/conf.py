"""Settings of the site, which ``python -m sphinx -W -n docs site`` builds without a network (decision 19)."""

import hashlib
import sys
from pathlib import Path

from dcgrid_env import __version__

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(Path(__file__).parent / "extensions"))
sys.path.append(str(ROOT))  # docs.studies is not installed


def hash_of_the_package() -> str:
    """Hash of all files of the package, code and data."""
    rooms = [ROOT / name for name in ("dcgrid_env", "traces", "baselines", "agents", "apps")]
    found = hashlib.sha256(__version__.encode())
    for path in sorted(path for room in rooms for path in room.rglob("*")):
        if path.is_file() and path.suffix != ".pyc":
            found.update(f"{path.relative_to(ROOT)}\n".encode() + path.read_bytes())
    return found.hexdigest()[:16]


project = "dcgrid"
author = "The dcgrid authors"
copyright = "2026, the dcgrid authors"
release = __version__

extensions = [
    "myst_nb",
    "notebooks",
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
nb_execution_mode = "cache"
# MyST-NB runs a notebook again only if its cells change. This name changes with the package, so outputs are never old.
nb_execution_cache_path = str(ROOT / "build" / "tutorials" / hash_of_the_package())
nb_execution_in_temp = True
nb_execution_timeout = 600  # of a cell, s
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True

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
