// Runs of polygons in `work`: instance, first polygon, number of polygons with RUN_NEAR_BIT, box in the arena. A run is
// split into units of UNIT polygons: run << UNIT_SHIFT | number of the unit.

const RUN_INSTANCE: u32 = 0u;
const RUN_POLYGON: u32 = 1u;
const RUN_COUNT: u32 = 2u;
const RUN_BOX: u32 = 3u;
const RUN_WORDS: u32 = 4u;
// Flag in the count: the run is around the sensor.
const RUN_NEAR_BIT: u32 = 0x80000000u;

const UNIT: u32 = 8u;
// A run has at most 1 << UNIT_SHIFT units.
const UNIT_SHIFT: u32 = 3u;
// A box in the arena: minimum and maximum corner.
const BOX_WORDS: u32 = 6u;
