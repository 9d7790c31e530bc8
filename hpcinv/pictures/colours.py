"""Names of the fields in whose colours a result is drawn."""

from typing import Literal, get_args

type Colour = Literal["displacement", "von-mises", "pressure", "J", "error"]
COLOURS: tuple[Colour, ...] = get_args(Colour.__value__)
