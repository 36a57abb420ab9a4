"""Sphinx configuration: Markdown pages, what the code knows taken from the code, nothing from the network."""

import subprocess
import sys
from pathlib import Path

import hd_diag

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE)]  # for the extension in from_code/

project = "hd_diag"
author = "hd_diag contributors"
copyright = author
version = release = hd_diag.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc", "from_code"]
exclude_patterns = ["_build", "tables", "examples"]

myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
smartquotes = False  # '' is a value of parameters

autosummary_generate = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # numpydoc's sections tell types, shapes and units
autodoc_class_signature = "separated"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_math_renderer = "mathml"
html_theme = "furo"
html_title = "hd_diag"
html_static_path = ["static"]
html_css_files = ["wrap.css"]
html_copy_source = False
html_show_sourcelink = False

FIGURES = HERE / "_build" / "figures"
subprocess.run(
    [sys.executable, "-m", "hd_diag", "figures", "--out", str(FIGURES)],
    cwd=HERE,
    check=True,
    stdout=subprocess.DEVNULL,
)
