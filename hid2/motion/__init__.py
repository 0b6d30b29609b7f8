"""Reference lines, routes, Frenet smoothing, and the last check before export."""
