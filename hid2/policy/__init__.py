"""The paper's chapter Agent Policy: Algorithm 1, lane change, overtake, turns."""
