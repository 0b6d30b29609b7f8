"""What a recorded scene may be at most: anything beyond is refused at reading, in one line.

A real scene is far below each of these (the figures are those of Argoverse 2's motion-forecasting scenes). They are
there so that a file from anywhere costs bounded time and memory: what follows grows with the cells of the map, the
pairs of tracks, and the ground that both lie on.
"""

#: Each map file of a whole city, MB.
MAX_CITY_MB = 128
#: A sidecar, MB. Real: 0.11 with 62 vehicles. What is read of JSON takes up to 400 times the memory of the file.
MAX_SIDECAR_MB = 2
#: Parquet: rows, columns, and bytes that the columns unpack to, MB. Real: 10,000 rows, 18 columns, 2 MB.
MAX_ROWS, MAX_COLUMNS, MAX_TABLE_MB = 200_000, 200, 256
#: Timesteps of a synthetic corridor: an hour.
MAX_CORRIDOR_STEPS = 36_000
#: Tracks of a scene. Real: below 300.
MAX_TRACKS = 2_000
#: Length of an id or a name in a scene, characters. Real: 36.
MAX_NAME = 200
#: Lane segments and drivable areas of a map, and points of one line of it. Real: below 400, 50 and 3,000.
MAX_LANES, MAX_AREAS, MAX_POINTS = 3_000, 1_000, 20_000
#: A lane, and all lanes of a map together, m. Real: 200 and 15,000.
MAX_LANE_M, MAX_LANES_M = 5_000.0, 100_000.0
#: Width and height of the ground that the map and all tracks lie on, m. Real: below 1,000.
MAX_EXTENT_M = 10_000.0
#: Distance from the origin, m: UTM coordinates are below.
MAX_COORDINATE_M = 1e7
#: Speed of anything, m/s: the format's fastest trains are below 100.
MAX_SPEED_MPS = 1_000.0
#: Lane ids are 64-bit integers with a sign.
MAX_LANE_ID = 2**63 - 1
