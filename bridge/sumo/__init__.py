"""Everything that touches SUMO."""
