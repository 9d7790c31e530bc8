"""Configuration of the documentation site: ``python3 -m uv run --group docs sphinx-build -W docs results/site``."""

from hpcinv.version import __version__

project = "hpcinv"
copyright = "the authors of hpcinv"
release = version = __version__
extensions = ["myst_parser", "sphinx.ext.mathjax"]
root_doc = "index"
exclude_patterns = ["results"]
nitpicky = True
html_theme = "furo"
html_title = f"hpcinv {release}"
html_show_copyright = False
html_static_path = []
html_copy_source = False
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 4
myst_links_external_new_tab = False
suppress_warnings = ["misc.highlighting_failure"]  # blocks of output and of formulas are in no language
