// Work items of a line grid: a polygon and some of its lines, so that a big polygon spreads over many invocations.

fn add_items(at: u32, instance: Instance, survivor: Survivor, first_corner: u32, corner_count: u32) {
    let first = survivor.lines & 0xffffu;
    let count = survivor.lines >> 16u;
    let share = max(LINES_PER_ITEM, (count + ITEMS_PER_POLYGON - 1u) / ITEMS_PER_POLYGON);
    let wanted = (count + share - 1u) / share;
    let base = reserve_items(wanted);
    for (var i = 0u; i < wanted; i++) {
        put_item(base + i, at, (first + i * share) | (min(share, count - i * share) << 16u));
    }
}
