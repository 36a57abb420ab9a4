"""Sphinx configuration: pages of plain Markdown (see generate.py), nothing from the network."""

import sys
from pathlib import Path

import hd_diag

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE)]  # for the extension in site_of_pages/

project = "hd_diag"
author = "hd_diag contributors"
copyright = author
version = release = hd_diag.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc", "site_of_pages"]
exclude_patterns = ["_build", "tables", "examples", "parts", "site_of_pages"]

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
