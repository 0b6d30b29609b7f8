"""Reference lines, routes, Frenet smoothing."""
