"""Configuration of the documentation site: ``python3 -m uv run --group docs sphinx-build -W docs results/site``."""

import sys
from pathlib import Path

from hpcinv.version import __version__

sys.path.insert(0, str(Path(__file__).parent))  # for the extensions next to it

project = "hpcinv"
copyright = "the authors of hpcinv"
release = version = __version__
extensions = ["myst_nb", "mathml", "stress_plots"]
root_doc = "index"
exclude_patterns = ["results"]
nitpicky = True
html_math_renderer = "mathml"
html_theme = "furo"
html_title = f"hpcinv {release}"
html_show_copyright = False
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_copy_source = False
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 4
myst_links_external_new_tab = False
nb_execution_mode = "off"  # notebooks keep their output: docs/execute_notebooks.py
suppress_warnings = ["misc.highlighting_failure"]  # blocks of output and of formulas are in no language
