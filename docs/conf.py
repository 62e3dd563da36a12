"""Configuration of the documentation site: `make docs` builds it from a checkout, offline, into build/site."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from sphinx_gallery.sorting import FileNameSortKey

import fracbench

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs" / "_ext"))
from from_files import copy_gallery  # noqa: E402

copy_gallery(ROOT / "docs" / "gallery", ROOT / "build" / "gallery")

# The gallery runs on one thread, so that its pictures are the same on every build.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

project = "fracbench"
author = "the fracbench authors"
copyright = "BSD-3-Clause"
version = release = fracbench.__version__

extensions = [
    "from_files",
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx-mathjax-offline",  # equations are set without a network
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "sphinxcontrib.bibtex",
]
default_role = "obj"  # names in single backticks, as docstrings have them
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_ext", "gallery", "generated/parts"]
suppress_warnings = ["config.cache"]  # the order of the gallery is a class, which has no cache

myst_enable_extensions = ["colon_fence", "dollarmath", "amsmath", "deflist", "attrs_block"]
myst_heading_anchors = 3
myst_links_external_new_tab = False

autodoc_typehints = "none"  # numpydoc's sections give types, shapes and units
autosummary_generate = True
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
bibtex_bibfiles = ["references.bib"]
bibtex_default_style = "plain"

# Inventories of other projects make links where there is a network, and are no error without one.
intersphinx_mapping = (
    {
        "numpy": ("https://numpy.org/doc/stable", None),
        "python": ("https://docs.python.org/3", None),
    }
    if os.environ.get("FRACBENCH_DOCS_ONLINE")
    else {}
)

sphinx_gallery_conf = {
    "examples_dirs": "../build/gallery",
    "gallery_dirs": "auto_gallery",
    "filename_pattern": "/plot_",
    "within_subsection_order": FileNameSortKey,
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,
    "remove_config_comments": True,
    "copyfile_regex": r".*\.rst",
    "show_signature": False,
    "reset_modules": ("matplotlib", "from_files.house_look"),
}

html_theme = "pydata_sphinx_theme"
html_title = "fracbench"
html_sidebars = {"index": [], "start": [], "answer": []}
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["filter.js"]
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False
html_last_updated_fmt = None
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "footer_start": [],
    "footer_end": [],
    "icon_links": [],
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
}
