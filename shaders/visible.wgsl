// Stage 5, if features are requested: one invocation per sample of a feature. Among the polygons that the nine pixels
// around the sample show, it finds the nearest that hides it. The answer is a proposal: the CPU verifies it in f64, and
// confirms visible samples with rays.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> keys: array<vec2u>;
@group(0) @binding(2) var<storage, read> seen_slots: array<u32>;
@group(0) @binding(3) var<storage, read> records: array<u32>;
// Words: SAMPLES_AT words of header (number of samples, columns of a turn if they wrap around), samples of SAMPLE_WORDS
// (place in the line frame, row-major pixel, offset of its feature's slots), then lists of slots (count, slots).
@group(0) @binding(4) var<storage, read> asked: array<u32>;
@group(0) @binding(5) var<storage, read_write> answers: array<u32>;

const SAMPLES_AT: u32 = 4u;
// Words of a sample. PLACE: three words. SLOTS: offset of its list of slots.
const SAMPLE_PLACE: u32 = 0u;
const SAMPLE_PIXEL: u32 = 3u;
const SAMPLE_SLOTS: u32 = 4u;
const SAMPLE_WORDS: u32 = 5u;
// Words of the header.
const ASKED_COUNT: u32 = 0u;
const ASKED_TURN: u32 = 1u;
// Special answers, not slots.
const DOUBT: u32 = 0xffffffffu;
const SEEN: u32 = 0xfffffffeu;
// Flag of stamps; their records are on the CPU only.
const STAMPED: u32 = 0x80000000u;

@compute @workgroup_size(64)
fn visible(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = (group.y * groups.x + group.x) * GROUP + lane;
    if index < asked[ASKED_COUNT] {
        answers[index] = answer(SAMPLES_AT + index * SAMPLE_WORDS);
    }
}

fn answer(at: u32) -> u32 {
    let p = at + SAMPLE_PLACE;
    let place = vec3f(bitcast<f32>(asked[p]), bitcast<f32>(asked[p + 1u]), bitcast<f32>(asked[p + 2u]));
    let column = asked[at + SAMPLE_PIXEL] % params.width;
    let row = asked[at + SAMPLE_PIXEL] / params.width;
    let own = asked[at + SAMPLE_SLOTS];
    let turn = asked[ASKED_TURN];
    var best = 1.0;
    var by = DOUBT;
    var covered = false;
    var beside = false;
    var last = DOUBT;
    for (var i = 0u; i < 9u; i++) {
        // Unsigned: a row or column before the first wraps to a number beyond the last.
        let r = row + i / 3u - 1u;
        var c = column + i % 3u - 1u;
        if turn != 0u {
            c = (c + turn) % turn;
        }
        if r >= params.height || c >= params.width {
            continue;
        }
        let key = keys[select(r * params.width + c, c * params.height + r, GRID == SCANNER)];
        let slot = ~key.x;
        if key.x == 0u || key.y == 0u || slot == last {
            continue;
        }
        last = slot;
        let record = seen_slots[slot * SLOT_WORDS + SLOT_RECORD];
        if record >= STAMPED {
            beside = true;
            continue;
        }
        let share = dot(word3(record + RECORD_M), place);
        let holds = covers(record, place);
        if lies_on(own, slot) {
            covered = covered || holds;
        } else if holds && share > best {
            best = share;
            by = slot;
        } else {
            covered = covered || holds;
            beside = beside || !holds && share > 1.0;
        }
    }
    return select(by, SEEN, by == DOUBT && covered && !beside);
}

fn word3(at: u32) -> vec3f {
    return vec3f(bitcast<f32>(records[at]), bitcast<f32>(records[at + 1u]), bitcast<f32>(records[at + 2u]));
}

fn covers(record: u32, place: vec3f) -> bool {
    let count = records[record + RECORD_EDGE_COUNT];
    for (var k = 0u; k < count; k++) {
        if dot(word3(record + RECORD_WORDS + k * EDGE_WORDS), place) < 0.0 {
            return false;
        }
    }
    return true;
}

fn lies_on(own: u32, slot: u32) -> bool {
    let count = asked[own];
    for (var k = 1u; k <= count; k++) {
        if asked[own + k] == slot {
            return true;
        }
    }
    return false;
}
