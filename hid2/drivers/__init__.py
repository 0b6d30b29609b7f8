"""How people drive: a driver for each inserted vehicle, and how they wander."""
