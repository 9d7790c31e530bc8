"""Names of the fields in whose colours a result is drawn."""

from typing import Literal, get_args

type Colour = Literal["displacement", "von-mises", "pressure", "J", "error", "regions"]
COLOURS: tuple[Colour, ...] = get_args(Colour.__value__)
REGIONS = ("#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#0072B2", "#D55E00", "#F0E442", "#999999")
"""colours of regions in pictures and pages, in the order of the regions (Okabe & Ito)"""
