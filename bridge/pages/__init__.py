"""Pages and charts: one shell, one form of tables and figures, and the prose of every page as a template."""
