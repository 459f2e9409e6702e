//! Compares the spatial indexes with rivals in one process: `cargo bench --bench index [-- query|build|move|size [--out
//! DIR]]`.
//! The contenders' rounds alternate, the fastest round of each counts, and ratios are relative to the default index.

#![allow(clippy::print_stdout, reason = "the program prints tables")]

use glam::{DVec2, DVec3, Vec3};
use parry3d_f64::bounding_volume::Aabb as ParryBox;
use parry3d_f64::partitioning::{Bvh, BvhBuildStrategy, BvhNode, TraversalAction};
use presight_model::change::Change;
use presight_model::environment::{CUBOID_FACES, cuboid_corners};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::{Aabb, Pose};
use presight_model::index::{IndexKind, Params, QueryResult, Rect, Region, Sector, SpatialIndex, WorldIndex};
use presight_model::world::World;
use presight_read::gltf::{ImportOptions, import};
use presight_studies::index::Scheme;
use rstar::{AABB, RTree, RTreeObject, SelectionFunction};
use std::f64::consts::TAU;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// SplitMix64.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A machine of about 500 polygons: boxes within 2 x 2 x 2 m.
fn machine(random: &mut Random, polygons: usize) -> Arc<Mesh> {
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    while faces.len() < polygons {
        let mut unit = || random.unit() as f32;
        let at = Vec3::new(unit() * 2.0, unit() * 2.0, unit() * 2.0);
        let size = Vec3::new(unit(), unit(), unit()) * 0.3 + 0.02;
        let first = vertices.len() as u32;
        vertices.extend(cuboid_corners(at, size + at));
        for f in CUBOID_FACES {
            faces.push(Polygon::new(f.map(|c| c + first).to_vec(), 0));
        }
    }
    faces.truncate(polygons);
    Arc::new(Mesh::new("machine", vertices, faces, PolygonOrder::Spatial).expect("valid boxes"))
}

/// A factory of this many polygons: machines of 20 kinds at any heading, 48 polygons a square metre. The paper's sector
/// holds about 2,500 of them at any size. Machines of a kind share a mesh, or have copies if `own` is set.
fn factory(polygons: usize, own: bool) -> Environment {
    let mut random = Random(7);
    let kinds: Vec<Arc<Mesh>> = (0..20).map(|_| machine(&mut random, 500)).collect();
    let side = (polygons as f64 / 48.0).sqrt();
    let mut environment = Environment::new();
    environment.add_material(Material::named("steel")).expect("one material");
    for i in 0..polygons.div_ceil(500) {
        let at = DVec3::new(random.unit() * side, random.unit() * side, 0.0);
        let pose = Pose::from_xyz_rpy(at, 0.0, 0.0, random.unit() * TAU);
        let mesh = if own { machine(&mut random, (polygons - 500 * i).min(500)) } else { kinds[i % 20].clone() };
        environment.insert(NewObject::new(format!("machine {i}"), pose, mesh)).expect("it fits");
    }
    environment
}

fn boxes_of(environment: &Environment) -> Vec<(u32, Aabb)> {
    let corners = |slot| environment.polygon_in_world(slot).map(|c| (slot, Aabb::of(c)));
    (0..environment.slot_count()).filter_map(corners).collect()
}

fn side_of(boxes: &[(u32, Aabb)]) -> f64 {
    boxes.iter().fold(0.0, |m, (_, b)| b.max.x.max(m))
}

struct Flat {
    id: u32,
    rect: Rect,
}

impl RTreeObject for Flat {
    type Envelope = AABB<[f64; 2]>;

    fn envelope(&self) -> Self::Envelope {
        AABB::from_corners(self.rect.min.to_array(), self.rect.max.to_array())
    }
}

/// A query of rstar's tree with the same exact sector test at nodes and leaves.
struct InSector(Sector, DVec2);

impl SelectionFunction<Flat> for InSector {
    fn should_unpack_parent(&self, envelope: &AABB<[f64; 2]>) -> bool {
        let rect = Rect { min: DVec2::from(envelope.lower()) - self.1, max: DVec2::from(envelope.upper()) - self.1 };
        self.0.meets(&rect)
    }

    fn should_unpack_leaf(&self, leaf: &Flat) -> bool {
        self.0.meets(&Rect { min: leaf.rect.min - self.1, max: leaf.rect.max - self.1 })
    }
}

fn flat((id, b): &(u32, Aabb)) -> Flat {
    Flat { id: *id, rect: Rect { min: b.min.truncate(), max: b.max.truncate() } }
}

fn parry_boxes(boxes: &[(u32, Aabb)]) -> Vec<ParryBox> {
    let vector = |p: DVec3| [p.x, p.y, p.z].into();
    boxes.iter().map(|(_, b)| ParryBox::new(vector(b.min), vector(b.max))).collect()
}

/// A contender: its name, and a query that appends ids.
type Contender<'a> = (&'static str, Box<dyn FnMut(&Query, &mut Vec<u32>) + 'a>);

/// The paper's query at some place.
struct Query {
    apex: DVec2,
    sector: Sector,
    region: Region,
}

fn queries(side: f64, radius: f64, count: usize) -> Vec<Query> {
    let mut random = Random(3);
    let opening = 60f64.to_radians();
    let inside = (side - 2.0 * radius).max(0.0);
    let query = |_| {
        let apex = DVec2::new(random.unit(), random.unit()) * inside + (side - inside) / 2.0;
        let heading = TAU * random.unit();
        Query {
            apex,
            sector: Sector::new(heading, opening, radius),
            region: Region::sector(apex, heading, opening, radius),
        }
    };
    (0..count).map(query).collect()
}

/// The microseconds for a query in each contender's fastest round, and the ids found in the last round.
fn race(contenders: &mut [Contender<'_>], queries: &[Query], rounds: usize) -> Vec<(f64, usize)> {
    let mut best = vec![(f64::INFINITY, 0); contenders.len()];
    let mut ids = Vec::new();
    for _ in 0..rounds {
        for (best, (_, query)) in best.iter_mut().zip(contenders.iter_mut()) {
            let mut found = 0;
            let start = Instant::now();
            for q in queries {
                ids.clear();
                query(q, &mut ids);
                found += black_box(&ids).len();
            }
            let us = start.elapsed().as_secs_f64() * 1e6 / queries.len() as f64;
            *best = (best.0.min(us), found / queries.len());
        }
    }
    best
}

fn by_index<'a>(index: &'a dyn SpatialIndex) -> impl FnMut(&Query, &mut Vec<u32>) + 'a {
    let mut found = QueryResult::default();
    move |q, ids| {
        found.clear();
        index.query(&q.region, &mut found);
        std::mem::swap(&mut found.ids, ids);
    }
}

fn by_world<'a>(index: &'a WorldIndex, environment: &'a Environment) -> impl FnMut(&Query, &mut Vec<u32>) + 'a {
    let mut found = QueryResult::default();
    move |q, ids| {
        found.clear();
        index.query(environment, &q.region, &mut found);
        // Predictions can use the runs directly; here they are expanded to ids as for all other contenders.
        ids.extend(found.all());
    }
}

fn query_bench() {
    let environment = factory(50_000, false);
    let boxes = boxes_of(&environment);
    println!("## The paper's sector in {} polygons\n", boxes.len());
    let queries = queries(side_of(&boxes), 10.0, 200);
    let indexes: Vec<_> = [Scheme::Grid, Scheme::Plop, Scheme::S2d, Scheme::S3d]
        .map(|s| (s.name(), s.build(s.params(), &boxes).expect("it is over polygons")))
        .into();
    let two_level = WorldIndex::new(&environment, &IndexKind::default());
    let wide = Params { cell_polygons: 1 << 16, ..Params::default() };
    let all_in_one = Scheme::S2d.build(wide, &boxes).expect("it is over polygons");
    let rects: Vec<Flat> = boxes.iter().map(flat).collect();
    let rtree = RTree::bulk_load(boxes.iter().map(flat).collect());
    let bvh = Bvh::from_leaves(BvhBuildStrategy::Binned, &parry_boxes(&boxes));
    let mut contenders: Vec<Contender<'_>> = vec![("two-level", Box::new(by_world(&two_level, &environment)))];
    for (name, index) in &indexes {
        contenders.push((name, Box::new(by_index(index.as_ref()))));
    }
    contenders.push((
        "rstar, exact sector test",
        Box::new(|q, ids| {
            ids.extend(rtree.locate_with_selection_function(InSector(q.sector, q.apex)).map(|f| f.id));
        }),
    ));
    contenders.push((
        "parry BVH, exact sector test",
        Box::new(|q, ids| {
            bvh.traverse(|node: &BvhNode| {
                let (min, max) = (node.mins(), node.maxs());
                let rect = Rect { min: DVec2::new(min.x, min.y) - q.apex, max: DVec2::new(max.x, max.y) - q.apex };
                if !q.sector.meets(&rect) {
                    return TraversalAction::Prune;
                }
                ids.extend(node.leaf_data());
                TraversalAction::Continue
            });
        }),
    ));
    contenders.push((
        "brute force, scalar",
        Box::new(|q, ids| {
            let met = |f: &&Flat| q.sector.meets(&Rect { min: f.rect.min - q.apex, max: f.rect.max - q.apex });
            ids.extend(rects.iter().filter(met).map(|f| f.id));
        }),
    ));
    contenders.push(("brute force, eight at a time", Box::new(by_index(all_in_one.as_ref()))));
    let times = race(&mut contenders, &queries, 30);
    println!("| contender | us a query | found | ratio to two-level | to s3d |\n|---|---|---|---|---|");
    for ((name, _), (us, found)) in contenders.iter().zip(&times) {
        println!("| {name} | {us:.1} | {found} | {:.2} | {:.2} |", us / times[0].0, us / times[4].0);
    }
    segments(&environment, &indexes, &two_level, side_of(&boxes));
    println!("\nbytes a polygon:");
    println!("- two-level {:.1} (meshes shared)", two_level.bytes() as f64 / boxes.len() as f64);
    let own = factory(50_000, true);
    let alone = WorldIndex::new(&own, &IndexKind::default());
    println!("- two-level {:.1} (no mesh shared)", alone.bytes() as f64 / own.slot_count() as f64);
    for (name, index) in &indexes {
        println!("- {name} {:.1}", index.bytes() as f64 / boxes.len() as f64);
    }
}

/// Measures the second sector test: the same sector unbounded in height, and between elevations of -10 and 10 degrees.
fn segments<'a>(
    environment: &'a Environment,
    indexes: &'a [(&'static str, Box<dyn SpatialIndex>)],
    two_level: &'a WorldIndex,
    side: f64,
) {
    let flat = queries(side, 10.0, 200);
    let mut random = Random(3);
    let upright: Vec<Query> = flat
        .iter()
        .map(|q| {
            let pose = Pose { translation: q.apex.extend(1.0), ..Pose::IDENTITY };
            // The same seed repeats the headings.
            let (_, _, heading) = (random.unit(), random.unit(), TAU * random.unit());
            let region =
                Region::segment(&pose, heading, 60f64.to_radians(), (-0.1745, 0.1745), 10.0).expect("a valid pose");
            Query { region, ..*q }
        })
        .collect();
    println!("\n| index | sector us | found | segment us | found | ratio |\n|---|---|---|---|---|---|");
    let mut contenders: Vec<Contender<'a>> = vec![("two-level", Box::new(by_world(two_level, environment)))];
    for (name, index) in indexes {
        contenders.push((name, Box::new(by_index(index.as_ref()))));
    }
    let (first, second) = (race(&mut contenders, &flat, 20), race(&mut contenders, &upright, 20));
    for (((name, _), (us, n)), (second_us, second_n)) in contenders.iter().zip(first).zip(second) {
        println!("| {name} | {us:.1} | {n} | {second_us:.1} | {second_n} | {:.2} |", second_us / us);
    }
}

/// The milliseconds of the fastest of several runs.
fn fastest<T>(rounds: usize, mut run: impl FnMut() -> T) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..rounds {
        let start = Instant::now();
        black_box(run());
        best = best.min(start.elapsed().as_secs_f64() * 1e3);
    }
    best
}

fn build_bench() {
    let environment = factory(1_000_000, true);
    let boxes = boxes_of(&environment);
    println!(
        "\n## Build of {} polygons, {} threads\n",
        boxes.len(),
        std::thread::available_parallelism().map_or(1, |n| n.get())
    );
    let leaves = parry_boxes(&boxes);
    let parry = fastest(3, || Bvh::from_leaves(BvhBuildStrategy::Binned, &leaves));
    let ploc = fastest(3, || Bvh::from_leaves(BvhBuildStrategy::Ploc, &leaves));
    let rstar = fastest(3, || RTree::bulk_load(boxes.iter().map(flat).collect()));
    println!("| contender | ms | ratio to parry's BVH (binned) |\n|---|---|---|");
    let row = |name: &str, ms: f64| println!("| {name} | {ms:.0} | {:.2} |", ms / parry);
    row("parry BVH, binned", parry);
    row("parry BVH, PLOC", ploc);
    row("rstar, bulk load", rstar);
    for scheme in [Scheme::Grid, Scheme::Plop, Scheme::S2d, Scheme::S3d] {
        row(scheme.name(), fastest(3, || scheme.build(scheme.params(), &boxes)));
    }
    row("two-level, no mesh shared", fastest(3, || WorldIndex::new(&environment, &IndexKind::default())));
}

fn data(name: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let data = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    data.join("env").join(name)
}

fn move_bench() {
    let path = data("hospital.glb");
    println!("\n## Moving an object of 500 polygons in the hospital\n");
    if !path.is_file() {
        println!("SKIPPED: {} is missing", path.display());
        return;
    }
    println!("| index | us a move, median of 2,000 |\n|---|---|");
    for scheme in Scheme::ALL {
        let imported = import(&path, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        let mut world = World::with_index(imported.environment, &scheme.tuned());
        let mesh = machine(&mut Random(1), 500);
        world.apply(Change::InsertObject(NewObject::new("machine", Pose::IDENTITY, mesh))).expect("it fits");
        let mut random = Random(5);
        let mut times: Vec<f64> = (0..2000)
            .map(|_| {
                let at = DVec3::new(random.unit() * 40.0 - 20.0, random.unit() * 40.0 - 20.0, 0.0);
                let pose = Pose::from_xyz_rpy(at, 0.0, 0.0, random.unit() * TAU);
                let start = Instant::now();
                world
                    .apply(Change::MoveObject { name: "machine".into(), world_from_object: pose })
                    .expect("the store exists");
                start.elapsed().as_secs_f64() * 1e6
            })
            .collect();
        times.sort_by(f64::total_cmp);
        println!("| {} | {:.1} |", scheme.name(), times[times.len() / 2]);
    }
}

fn size_bench(out: Option<&Path>) {
    println!("\n## Cost against size: a sector of 2 m and 60 degrees, about 100 polygons found\n");
    let sizes = [1_000, 10_000, 100_000, 1_000_000, 10_000_000];
    let schemes = [Scheme::Grid, Scheme::Plop, Scheme::S2d, Scheme::S3d, Scheme::TwoLevel];
    let mut curves: Vec<Vec<(f64, f64)>> = vec![Vec::new(); schemes.len()];
    println!("| polygons | {} | found |\n|---|---|---|---|---|---|---|", schemes.map(Scheme::name).join(" | "));
    for size in sizes {
        let environment = factory(size, false);
        let boxes = boxes_of(&environment);
        let queries = queries(side_of(&boxes), 2.0, 200);
        let mut cells = Vec::new();
        let mut found = 0;
        for (curve, scheme) in curves.iter_mut().zip(schemes) {
            // One index at a time: memory holds ten million polygons only once.
            let index = WorldIndex::new(&environment, &scheme.tuned());
            let mut contenders: Vec<Contender<'_>> = vec![(scheme.name(), Box::new(by_world(&index, &environment)))];
            let (us, n) = race(&mut contenders, &queries, 10)[0];
            curve.push((size as f64, us));
            cells.push(format!("{us:.1}"));
            found = n;
        }
        println!("| {size} | {} | {found} |", cells.join(" | "));
    }
    if let Some(out) = out {
        let names = schemes.map(Scheme::name);
        std::fs::write(out.join("index_size.svg"), plot(&names, &curves)).expect("the folder can be written");
    }
}

fn plot(names: &[&str], curves: &[Vec<(f64, f64)>]) -> String {
    use plotters::prelude::*;
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (900, 540)).into_drawing_area();
        area.fill(&WHITE).expect("text can be drawn to");
        let highest = curves.iter().flatten().map(|p| p.1).fold(0.0, f64::max);
        let mut chart = ChartBuilder::on(&area)
            .caption("2 m, 60 degree sector: us a query against polygons", ("sans-serif", 20))
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(64)
            .build_cartesian_2d((1e3..1e7f64).log_scale(), 0.0..1.1 * highest)
            .expect("the area is large enough");
        chart
            .configure_mesh()
            .x_desc("polygons")
            .x_label_formatter(&|n| format!("{n}"))
            .y_desc("us")
            .max_light_lines(0)
            .draw()
            .expect("text can be drawn to");
        let colors = [(230, 159, 0), (86, 180, 233), (0, 158, 115), (213, 94, 0), (0, 114, 178)];
        for ((name, curve), (r, g, b)) in names.iter().zip(curves).zip(colors) {
            let color = RGBColor(r, g, b);
            let line = LineSeries::new(curve.iter().copied(), color.stroke_width(3));
            chart
                .draw_series(line)
                .expect("text can be drawn to")
                .label((*name).to_owned())
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], color.stroke_width(3)));
        }
        let mut labels = chart.configure_series_labels();
        labels.position(SeriesLabelPosition::UpperLeft).border_style(BLACK).background_style(WHITE);
        labels.label_font(("sans-serif", 16)).draw().expect("text can be drawn to");
        area.present().expect("text can be drawn to");
    }
    svg
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let out = arguments.iter().position(|a| a == "--out").and_then(|i| arguments.get(i + 1)).map(PathBuf::from);
    let asked: Vec<&str> =
        ["query", "build", "move", "size"].into_iter().filter(|n| arguments.iter().any(|a| a == n)).collect();
    let wanted = |name: &str| asked.is_empty() || asked.contains(&name);
    if wanted("query") {
        query_bench();
    }
    if wanted("move") {
        move_bench();
    }
    if wanted("build") {
        build_bench();
    }
    if wanted("size") {
        size_bench(out.as_deref());
    }
}
