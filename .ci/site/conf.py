"""Settings of Sphinx."""

project, html_theme, extensions = "hid2-sumo", "furo", ["myst_nb", "sphinx.ext.autodoc"]
myst_heading_anchors, nb_execution_mode, autodoc_typehints, html_extra_path = 4, "off", "none", ["extra"]
