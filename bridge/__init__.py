"""Everything that touches a file, a process or libsumo."""
