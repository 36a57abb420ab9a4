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
html_css_files = ["pages.css"]
html_copy_source = False
html_use_index = html_domain_indices = False  # the search finds names
html_show_sourcelink = False

FIGURES = HERE / "_build" / "figures"
# The example drive's own page: its geometry is drawn.
PAGE = "--size 25 --ratio 100 --rated-torque 56 --k1 3.1e4 --k2 5.0e4 --k3 5.7e4 --t1 14 --t2 48"
DRAWN = ["--out", f"{FIGURES}/gear.yaml", "--figure", f"{FIGURES}/tooth_pair.svg"]
for words in (["figures", "--out", str(FIGURES)], ["gear", *PAGE.split(), *DRAWN]):
    command = [sys.executable, "-m", "hd_diag", *words]
    subprocess.run(command, cwd=HERE, check=True, stdout=subprocess.DEVNULL)
