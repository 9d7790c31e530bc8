"""``hpcinv bench``: what runs cost, as ratios within one session; every figure is that of a run of its own."""
