"""Why model and data differ: what each input moves, and which one would close the gap."""
