//! The shader text. Every unit concatenates common.wgsl and the files that its stage needs.

macro_rules! unit {
    ($($file:literal),+) => { concat!($(include_str!(concat!("../../shaders/", $file))),+) };
}

/// A stage that bounds polygons or boxes on one kind of grid.
macro_rules! bounding {
    ($stage:literal, $($grid:literal),+) => {
        unit!("common.wgsl", "arena.wgsl", "grid.wgsl", "runs.wgsl", "coarse.wgsl", $stage, $($grid),+)
    };
}

pub(super) const SIFT_CAMERA: &str = bounding!("sift.wgsl", "cull_camera.wgsl");
pub(super) const SIFT_SCANNER: &str = bounding!("sift.wgsl", "cull_scanner.wgsl");
pub(super) const SIFT_RAYS: &str = bounding!("sift.wgsl", "cull_rays.wgsl", "direction_map.wgsl", "pixel_fit.wgsl");
pub(super) const CULL_CAMERA: &str = bounding!("cull.wgsl", "cull_camera.wgsl");
pub(super) const CULL_SCANNER: &str = bounding!("cull.wgsl", "cull_scanner.wgsl");
pub(super) const CULL_RAYS: &str = bounding!("cull.wgsl", "cull_rays.wgsl", "direction_map.wgsl", "pixel_fit.wgsl");
pub(super) const FARTHEST: &str = unit!("common.wgsl", "grid.wgsl", "coarse.wgsl", "farthest.wgsl");
pub(super) const SETUP_LINES: &str =
    unit!("common.wgsl", "arena.wgsl", "exact.wgsl", "setup.wgsl", "shape.wgsl", "items_lines.wgsl");
pub(super) const SETUP_RAYS: &str =
    unit!("common.wgsl", "arena.wgsl", "exact.wgsl", "coarse.wgsl", "cones.wgsl", "setup.wgsl", "items_rays.wgsl");
pub(super) const RASTER_LINES_64: &str =
    unit!("common.wgsl", "grid.wgsl", "interval.wgsl", "raster_lines.wgsl", "key64.wgsl");
pub(super) const RASTER_LINES_32: &str =
    unit!("common.wgsl", "grid.wgsl", "interval.wgsl", "raster_lines.wgsl", "key32.wgsl");
pub(super) const DRAW_64: &str = unit!("common.wgsl", "grid.wgsl", "interval.wgsl", "draw.wgsl", "key64.wgsl");
pub(super) const DRAW_32: &str = unit!("common.wgsl", "grid.wgsl", "interval.wgsl", "draw.wgsl", "key32.wgsl");
pub(super) const RASTER_RAYS_64: &str =
    unit!("common.wgsl", "coarse.wgsl", "cones.wgsl", "raster_rays.wgsl", "key64.wgsl");
pub(super) const RASTER_RAYS_32: &str =
    unit!("common.wgsl", "coarse.wgsl", "cones.wgsl", "raster_rays.wgsl", "key32.wgsl");
pub(super) const RESOLVE: &str = unit!("common.wgsl", "resolve.wgsl");
pub(super) const WEIGH: &str = unit!("common.wgsl", "weigh.wgsl");
pub(super) const VISIBLE: &str = unit!("common.wgsl", "visible.wgsl");
pub(super) const ROI: &str = unit!("common.wgsl", "roi.wgsl");

#[cfg(test)]
mod tests {
    use super::super::layout::{
        self, ArenaPolygon, Counters, Instance, Item, MapLevel, MapSide, PackedFit, Params, Record, Slot, Survivor,
        WorkRun,
    };
    use super::super::roi::{self, RoiBox, RoiFeature, RoiParams, RoiPoint};
    use super::super::visible::{self, Sample};
    use super::super::weigh::WeighParams;
    use super::*;
    use naga::valid::{Capabilities, ValidationFlags, Validator};
    use presight_model::sensor::FitCell;
    use presight_render::plan::BeamNumbers;
    use std::mem::{offset_of, size_of};

    const UNITS: [(&str, &str); 19] = [
        ("sift camera", SIFT_CAMERA),
        ("sift scanner", SIFT_SCANNER),
        ("sift rays", SIFT_RAYS),
        ("farthest", FARTHEST),
        ("cull camera", CULL_CAMERA),
        ("cull scanner", CULL_SCANNER),
        ("cull rays", CULL_RAYS),
        ("setup lines", SETUP_LINES),
        ("setup rays", SETUP_RAYS),
        ("raster lines 64", RASTER_LINES_64),
        ("raster lines 32", RASTER_LINES_32),
        ("raster rays 64", RASTER_RAYS_64),
        ("raster rays 32", RASTER_RAYS_32),
        ("draw 64", DRAW_64),
        ("draw 32", DRAW_32),
        ("resolve", RESOLVE),
        ("weigh", WEIGH),
        ("visible", VISIBLE),
        ("roi", ROI),
    ];

    fn parse(name: &str, text: &str) -> naga::Module {
        naga::front::wgsl::parse_str(text).unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(text)))
    }

    #[test]
    fn every_shader_is_valid_without_a_gpu() {
        for (name, text) in UNITS {
            let module = parse(name, text);
            let with_int64 = Capabilities::SHADER_INT64 | Capabilities::SHADER_INT64_ATOMIC_MIN_MAX;
            let capabilities = if name.ends_with("64") { with_int64 } else { Capabilities::empty() };
            let valid = Validator::new(ValidationFlags::all(), capabilities).validate(&module);
            assert!(valid.is_ok(), "{name}: {}", valid.unwrap_err().emit_to_string(text));
        }
    }

    /// The greatest magnitude of all f32 literals of a module, functions included.
    fn greatest_literal(module: &naga::Module) -> f32 {
        let of_functions =
            module.functions.iter().map(|(_, f)| f).chain(module.entry_points.iter().map(|e| &e.function));
        let expressions = of_functions.map(|f| &f.expressions).chain([&module.global_expressions]);
        let magnitudes = expressions.flat_map(|all| all.iter()).map(|(_, expression)| match expression {
            naga::Expression::Literal(naga::Literal::F32(value)) => value.abs(),
            _ => 0.0,
        });
        magnitudes.fold(0.0, f32::max)
    }

    /// Vulkan states the precision of a division for divisors up to 2^126 only. Beyond, an H100 answers 0: scanners
    /// lost the polygons around their poles.
    #[test]
    fn no_number_is_too_great_to_divide_by() {
        for (name, text) in UNITS {
            assert!(greatest_literal(&parse(name, text)) < 2.0_f32.powi(126), "{name}");
        }
        let planted = CULL_SCANNER.replace("const HUGE: f32 = 1.0e37;", "const HUGE: f32 = 3.0e38;");
        assert!(greatest_literal(&parse("planted", &planted)) > 2.0_f32.powi(126));
    }

    #[test]
    fn the_64_bit_units_need_64_bits_and_a_broken_one_is_refused() {
        let module = parse("raster lines 64", RASTER_LINES_64);
        let refused = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module);
        assert!(refused.is_err());
        assert!(naga::front::wgsl::parse_str(&RESOLVE.replace("params.range_max", "params.no_such")).is_err());
    }

    /// Names and offsets of a struct's members, and its size, as laid out by naga.
    fn members(module: &naga::Module, name: &str) -> (Vec<(String, usize)>, usize) {
        for (_, t) in module.types.iter() {
            if let (Some(n), naga::TypeInner::Struct { members, span }) = (&t.name, &t.inner)
                && n == name
            {
                let list = members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset as usize));
                return (list.collect(), *span as usize);
            }
        }
        panic!("no struct {name}");
    }

    macro_rules! assert_same {
        ($module:expr, $type:ident: $($field:ident),+ $(,)?) => {
            let (found, size) = members($module, stringify!($type));
            let ours = vec![$((stringify!($field).to_owned(), offset_of!($type, $field))),+];
            assert_eq!(found, ours, stringify!($type));
            assert_eq!(size, size_of::<$type>(), stringify!($type));
        };
    }

    #[test]
    fn layouts_agree_with_the_shaders() {
        let module = parse("cull camera", CULL_CAMERA);
        assert_same!(&module, Params: line_count, sample_count, width, height, lines_at, weights_at, positions_at,
            line_buckets_at, sample_buckets_at, line_buckets, sample_buckets, tiles_at, rays_at, tile_columns,
            tile_count, units_at, facings_at, first_run, end_run, record_words, item_room, range_at, depth_at,
            polygon_at, object_at, cos_at, source_ids, first_line, last_line, first_sample, last_sample, fx, fy,
            range_min, range_max, stamp, coarse_at, coarse_columns, hiding, ahead_at, map_at, map_levels,
            fit_at);
        assert_same!(&module, Instance: linear_x, handedness, linear_y, first_slot, linear_z, first_source, normal_x,
            object_id, normal_y, polygons_at, normal_z, corners_at, center_high, vertices_at, center_low, padding);
        assert_same!(&module, Counters: survivors, record_words, items, edge_on, setup_groups, setup_y, setup_z,
            records, raster_groups, raster_y, raster_z, lost_ids, cull_groups, cull_y, cull_z, units,
            all_raster_groups, all_raster_y, all_raster_z, units_before, survivors_before, items_before, groups_before,
            runs_hidden, polygons_hidden, shapes, draw_vertices, draw_instances, draw_first_vertex, draw_first_instance,
            all_draw_vertices, all_draw_instances, all_draw_first_vertex, all_draw_first_instance);
        assert_same!(&module, Survivor: polygon, instance, lines, samples, flags, record, direction, least, greatest);
        let module = parse("weigh", WEIGH);
        assert_same!(&module, WeighParams: count, sensed_beams, predicted_beams, stride, parts, range_at, cos_at,
            sums_at, beam);
        assert_same!(&module, BeamNumbers: range_sigma, quadratic, turn, place, range_min, range_max, short, ln_short,
            below, near_there, ln_any, ln_hit, ln_none, ln_nothing);
        let module = parse("roi", ROI);
        assert_same!(&module, RoiParams: sensor, by, size, turn, log_fail, lowest, first, highest, margin, bent, much,
            slightly, slight, tail_steps, feature_count);
        assert_same!(&module, RoiFeature: origin, first_point, points, first_column, object_columns, columns);
        assert_same!(&module, RoiPoint: p, share, at, other_share, spread);
        assert_same!(&module, RoiBox: bounds, deviations, flag, padding);
    }

    /// Value of a module's constant.
    fn value(module: &naga::Module, name: &str) -> u32 {
        let found = module.constants.iter().find(|(_, c)| c.name.as_deref() == Some(name));
        let (_, c) = found.unwrap_or_else(|| panic!("no constant {name}"));
        match module.global_expressions[c.init] {
            naga::Expression::Literal(naga::Literal::U32(v)) => v,
            ref other => panic!("{name}: {other:?}"),
        }
    }

    macro_rules! assert_same_words {
        ($module:expr, $prefix:literal, $type:ident: $($field:ident),+ $(,)?) => {
            $({
                let name = format!("{}_{}", $prefix, stringify!($field).to_uppercase());
                assert_eq!(value($module, &name) as usize * 4, offset_of!($type, $field), "{name}");
            })+
            assert_eq!(value($module, concat!($prefix, "_WORDS")) as usize * 4, size_of::<$type>(), $prefix);
        };
    }

    #[test]
    fn words_agree_with_the_shaders() {
        let module = parse("cull camera", CULL_CAMERA);
        assert_same_words!(&module, "POLYGON", ArenaPolygon: first_corner, corners, source, normal, spread);
        assert_same_words!(&module, "RECORD", Record: m, slot, edge_count, cap_axis, cap_chord);
        assert_same_words!(&module, "SLOT", Slot: distance, object, source, record);
        assert_same_words!(&module, "ITEM", Item: record, part, within);
        assert_same_words!(&module, "RUN", WorkRun: instance, polygon, count);
        assert_eq!(value(&module, "RUN_BOX") as usize * 4, offset_of!(WorkRun, r#box));
        assert_eq!(value(&module, "COUNTED_ITEMS") as usize * 4, offset_of!(Counters, items));
        assert_eq!(value(&module, "COUNTED_ITEMS_BEFORE") as usize * 4, offset_of!(Counters, items_before));
        assert_eq!(value(&module, "COUNTED_SURVIVORS_BEFORE") as usize * 4, offset_of!(Counters, survivors_before));
        assert_same_words!(&parse("visible", VISIBLE), "SAMPLE", Sample: place, pixel, slots);
        let map = parse("cull rays", CULL_RAYS);
        assert_same_words!(&map, "LEVEL", MapLevel: sine2, across, sides);
        assert_same_words!(&map, "SIDE", MapSide: first, count, boxes_at);
        assert_same_words!(&map, "FIT", PackedFit: off, bend, column, row);
        // A moved field is detected.
        let moved = CULL_CAMERA.replace("RECORD_SLOT: u32 = 3u", "RECORD_SLOT: u32 = 4u");
        assert_ne!(value(&parse("moved", &moved), "RECORD_SLOT") as usize * 4, offset_of!(Record, slot));
    }

    #[test]
    fn constants_agree_with_the_shaders() {
        let module = parse("setup rays", SETUP_RAYS);
        let rays = parse("raster rays 32", RASTER_RAYS_32);
        for (name, ours) in [
            ("GROUP", layout::GROUP),
            ("MAX_GROUPS", layout::MAX_GROUPS),
            ("CORNER_WORDS", layout::CORNER_WORDS),
            ("VERTEX_WORDS", layout::VERTEX_WORDS),
            ("EDGE_WORDS", layout::EDGE_WORDS),
            ("FEW_INSTANCES", layout::FEW_INSTANCES),
            ("ITEMS_PER_POLYGON", layout::ITEMS_PER_POLYGON),
            ("LINES_PER_ITEM", layout::LINES_PER_ITEM),
            ("SAMPLES_PER_ITEM", layout::SAMPLES_PER_ITEM),
            ("CAMERA", layout::GridKind::Camera as u32),
            ("SCANNER", layout::GridKind::Scanner as u32),
            ("RAYS", layout::GridKind::Rays as u32),
        ] {
            assert_eq!(value(&module, name), ours, "{name}");
        }
        let module = parse("sift camera", SIFT_CAMERA);
        for (name, ours) in [
            ("RUN_NEAR_BIT", layout::RUN_NEAR),
            ("UNIT", layout::UNIT),
            ("UNIT_SHIFT", layout::UNIT_SHIFT),
            ("BOX_WORDS", layout::BOX_WORDS),
            ("BLOCK_WORDS", layout::BLOCK_WORDS),
        ] {
            assert_eq!(value(&module, name), ours, "{name}");
        }
        assert_eq!(value(&parse("farthest", FARTHEST), "TILE_SIDE"), layout::TILE_SIDE);
        let lines = parse("raster lines 32", RASTER_LINES_32);
        assert_eq!(value(&lines, "SHORT_GRID"), layout::SHORT_GRID);
        let boxes = parse("roi", ROI);
        for (name, ours) in [
            ("KIND", presight_features::roi::KIND),
            ("POINTS", roi::MAX_POINTS),
            ("MAX_SIDE_POINTS", presight_features::roi::MAX_SIDE_POINTS),
            ("EVENTS", presight_features::roi::EVENTS),
            ("TAIL_CELLS", presight_model::statistics::TAIL_CELLS),
            ("TAIL_COLUMNS", presight_model::statistics::TAIL_COLUMNS),
            ("TAIL_ROWS", presight_model::statistics::TAIL_ROWS),
            ("LINEAR", roi::LINEAR as usize),
        ] {
            assert_eq!(value(&boxes, name) as usize, ours, "{name}");
        }
        assert_eq!(value(&rays, "TILES_PER_SUPERTILE"), layout::TILES_PER_SUPERTILE);
        let cull = parse("cull rays", CULL_RAYS);
        assert_eq!(value(&cull, "PIXEL_BOX_WORDS"), layout::PIXEL_BOX_WORDS);
        assert_eq!(value(&cull, "FIT_ACROSS"), FitCell::ACROSS);
        assert!(CULL_RAYS.contains(&format!("const FIT_CELL: f32 = {};", FitCell::SIDE)));
        let seen = parse("visible", VISIBLE);
        assert_eq!(value(&seen, "SAMPLES_AT"), visible::SAMPLES_AT as u32);
        assert_eq!(visible::hint_of_word(value(&seen, "DOUBT")), presight_features::OcclusionHint::Doubt);
        assert_eq!(visible::hint_of_word(value(&seen, "SEEN")), presight_features::OcclusionHint::Seen);
        assert_eq!(value(&seen, "STAMPED"), super::super::near::STAMPED);
    }
}
