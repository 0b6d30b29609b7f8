"""Where agents are: sigma of the cells, boxes over time, obstacles along a path."""
