"""The map side: lane graphs, cells, SUMO nets."""
