"""How Sphinx builds the documentation; ``make docs`` runs it."""

import hashlib
import os
import shutil
import sys
from pathlib import Path

from fovden import __version__

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(HERE), str(ROOT)]  # for docstrings.py, gallery.py and the directives; for the benchmarks' tables

project, release, copyright = "fovden", __version__, "the fovden authors"  # noqa: A001 - Sphinx's word
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "myst_nb",
    "sphinx_copybutton",
    "docstrings",
    "gallery",
    "measured",
    "measured_foveations",
    "measured_levels",
    "measured_readings",
    "measured_tuning",
]
exclude_patterns = ["data", "pictures"]
nitpicky = True
nitpick_ignore_regex = [
    # Other projects' documentation would have to be fetched from the network to link to it.
    (r"py:.*", r"(torch|numpy|matplotlib|os|pathlib|collections|contextlib|typing|types|enum|dataclasses)\..*"),
    (r"py:class", r".*\.Owner"),  # a type variable
    (r"py:class", r"fovden\..*\.kernels\..*"),  # records of kernels, which are private
    (r"py:class", r".*\._\w+"),  # the package's private names, such as the keywords that constructors pass on
]

html_theme = "furo"
html_title = "fovden"
html_static_path = ["style.css"]
html_css_files = ["style.css"]
html_show_copyright = html_show_sphinx = html_copy_source = False
copybutton_prompt_text, copybutton_prompt_is_regexp = r">>> |\.\.\. ", True
copybutton_only_copy_prompt_lines = True

autodoc_default_options = {"members": True, "exclude-members": "extra_repr"}
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autosummary_generate = False
napoleon_numpy_docstring = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100

# Sphinx reads what lies below docs/ alone; notebooks live beside their scripts.
for notebook in (ROOT / "notebooks").glob("*.ipynb"):
    shutil.copy2(notebook, HERE)

# Notebooks run at their small size where FOVDEN_SMALL is set; its outputs are kept while no source changes.
SOURCES = b"".join(path.read_bytes() for path in sorted((ROOT / "fovden").rglob("*.py")))
SIZE = "small" if os.environ.get("FOVDEN_SMALL") else "full"
nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "out" / "docs-cache" / f"{SIZE}-{hashlib.sha256(SOURCES).hexdigest()[:16]}")
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_merge_streams = True
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
