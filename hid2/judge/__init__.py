"""The one judge of exported states: is it safe, can it be driven, did what is claimed happen."""
