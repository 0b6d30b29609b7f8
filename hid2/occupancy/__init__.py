"""Who is where: sigma of the cells, boxes over time, obstacles along a path."""
