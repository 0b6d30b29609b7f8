"""Where the city frames of Argoverse lie on the globe: UTM zone and origin, for SUMO's geo-reference.

The origins are those of av2 (`av2.geometry.utm`), projected once; a test compares them. Argoverse 1 has the same frames
for Miami and Pittsburgh.
"""

from typing import NamedTuple


class CityOrigin(NamedTuple):
    """Origin of a city frame: UTM zone on the northern half, easting and northing, m."""

    zone: int
    easting_m: float
    northing_m: float

    @property
    def projection(self) -> str:
        """As SUMO and PROJ write it."""
        return f"+proj=utm +zone={self.zone} +ellps=WGS84 +datum=WGS84 +units=m +no_defs"


#: By the names of cities in scenes.
CITY_ORIGINS = {
    "austin": CityOrigin(14, 621150.0275, 3349889.9996),
    "dearborn": CityOrigin(17, 320669.9346, 4685369.9988),
    "miami": CityOrigin(17, 580560.0088, 2850959.9999),
    "palo-alto": CityOrigin(10, 576480.0006, 4141379.9353),
    "pittsburgh": CityOrigin(17, 583710.0070, 4477259.9998),
    "washington-dc": CityOrigin(18, 323459.9997, 4306469.9870),
}
