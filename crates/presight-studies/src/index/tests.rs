use super::*;
use glam::{BVec3, DAffine3, DVec2, DVec3, Vec3};
use presight_model::change::Change;
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use presight_model::index::{QueryResult, Region, SplitAxis};
use presight_model::world::World;
use proptest::prelude::*;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

const FLAT: [Scheme; 4] = [Scheme::Grid, Scheme::Plop, Scheme::S2d, Scheme::S3d];

fn point() -> impl Strategy<Value = DVec3> {
    [-30.0..30.0f64, -30.0..30.0f64, -3.0..6.0f64].prop_map(DVec3::from)
}

/// Typical and extreme sets of boxes: evenly spread, in a line, at one point, a giant floor with screws, and all of
/// these far away.
fn boxes() -> impl Strategy<Value = Vec<Aabb>> {
    let around = |p: DVec3, half: DVec3| Aabb { min: p - half, max: p + half };
    let spread = prop::collection::vec((point(), point()), 0..300)
        .prop_map(move |all| all.into_iter().map(|(p, h)| around(p, h.abs() * 0.03)).collect());
    let line = prop::collection::vec(-30.0..30.0f64, 0..300)
        .prop_map(move |all| all.into_iter().map(|x| around(DVec3::X * x, DVec3::splat(0.01))).collect());
    let heap = (point(), 0..300usize).prop_map(move |(p, n)| vec![around(p, DVec3::ZERO); n]);
    let floor = prop::collection::vec(point(), 1..300).prop_map(move |all| {
        let floor = around(DVec3::ZERO, DVec3::new(40.0, 40.0, 0.0));
        all.into_iter().map(|p| around(p, DVec3::splat(0.002))).chain([floor]).collect()
    });
    let kinds = prop_oneof![spread, line, heap, floor];
    (kinds, prop_oneof![Just(0.0), Just(5e6), Just(-5e6)]).prop_map(|(boxes, far): (Vec<Aabb>, f64)| {
        boxes.into_iter().map(|b| Aabb { min: b.min + far, max: b.max + far }).collect()
    })
}

/// The region of a query, near or around the origin.
#[derive(Clone, Copy, Debug)]
enum Query {
    /// Apex, heading, opening, radius.
    Sector(DVec3, f64, f64, f64),
    /// Pose, heading, opening, elevations, radius.
    Segment(Pose, f64, f64, (f64, f64), f64),
    /// Apex, inward normals, radius.
    Frustum(DVec3, [DVec3; 4], f64),
    Cuboid(DVec3, DVec3),
    Everything,
}

impl Query {
    /// The region, moved by the same offset as the boxes.
    fn at(self, far: f64) -> Region {
        match self {
            Self::Sector(p, heading, opening, radius) => Region::sector((p + far).truncate(), heading, opening, radius),
            Self::Segment(pose, heading, opening, elevations, radius) => {
                let pose = Pose { translation: pose.translation + far, ..pose };
                Region::segment(&pose, heading, opening, elevations, radius).unwrap()
            }
            Self::Frustum(apex, normals, radius) => Region::frustum(apex + far, &normals, radius),
            Self::Cuboid(p, q) => Region::cuboid(&Aabb::of([p + far, q + far])),
            Self::Everything => Region::everything(),
        }
    }
}

/// Every form of region.
fn queries() -> impl Strategy<Value = Query> {
    let opening = || prop_oneof![0.01..TAU, Just(PI), Just(TAU), Just(PI / 3.0)];
    let radius = || prop_oneof![0.1..40.0f64, Just(10.0), Just(f64::INFINITY)];
    let lean = || prop_oneof![Just(0.0), -1.0..1.0f64, Just(1e-7)];
    let pose = (point(), lean(), lean(), -4.0..4.0f64).prop_map(|(p, r, q, y)| Pose::from_xyz_rpy(p, r, q, y));
    let sector = (point(), -4.0..4.0f64, opening(), radius())
        .prop_map(|(p, heading, opening, radius)| Query::Sector(p, heading, opening, radius));
    let segment = (pose, -4.0..4.0f64, opening(), [-1.57..1.57f64, -1.57..1.57f64], radius()).prop_map(
        |(pose, heading, opening, [a, b], radius)| Query::Segment(pose, heading, opening, (a.min(b), a.max(b)), radius),
    );
    let frustum = (point(), point(), 0.05..1.2f64, radius()).prop_map(|(apex, ahead, half, radius)| {
        let ahead = ahead.normalize_or(DVec3::X);
        let (side, up) = ahead.any_orthonormal_pair();
        let (sin, cos) = f64::sin_cos(half);
        Query::Frustum(apex, [side, -side, up, -up].map(|d| ahead * sin + d * cos), radius)
    });
    let cuboid = (point(), point()).prop_map(|(p, q)| Query::Cuboid(p, q));
    prop_oneof![sector, segment, frustum, cuboid, Just(Query::Everything)]
}

/// True for boxes that have a point in the region.
///
/// [`Region::meets`] is exact for sectors and cuboids. For other regions it keeps more, because their tests are
/// independent of each other, and boxes grow when they are rotated into a leaning frame. An index may exclude more by
/// its cells or by the region's bounds, so the box is halved until a point of it lies in the region.
fn must_be_found(query: Query, region: &Region, b: &Aabb) -> bool {
    const HALVINGS: usize = 10;
    fn witness(region: &Region, b: &Aabb, halvings: usize) -> bool {
        let corner = |i: usize| DVec3::select(BVec3::new(i & 1 > 0, i & 2 > 0, i & 4 > 0), b.max, b.min);
        if !region.meets(b) {
            return false;
        }
        if (0..8).any(|i| region.contains(corner(i))) || region.contains(region.origin().clamp(b.min, b.max)) {
            return true;
        }
        let (size, middle, mut halves) = (b.max - b.min, b.center(), [*b; 2]);
        let longest = size.max_position();
        (halves[0].max[longest], halves[1].min[longest]) = (middle[longest], middle[longest]);
        halvings > 0 && halves.iter().any(|half| witness(region, half, halvings - 1))
    }
    let exact = matches!(query, Query::Sector(..) | Query::Cuboid(..));
    region.meets(b) && (exact || witness(region, b, HALVINGS))
}

/// Checks that an index finds all it must, and nothing twice or far from the region.
fn check(index: &dyn SpatialIndex, scheme: Scheme, held: &[Option<Aabb>], query: Query, far: f64) {
    let (region, mut found) = (query.at(far), QueryResult::default());
    index.query(&region, &mut found);
    check_found(found.all().collect(), index, scheme, held, (query, &region));
}

/// As [`check`], of the ids that the index found.
fn check_found(
    mut ids: Vec<u32>,
    index: &dyn SpatialIndex,
    scheme: Scheme,
    held: &[Option<Aabb>],
    (query, region): (Query, &Region),
) {
    ids.sort_unstable();
    assert!(ids.windows(2).all(|w| w[0] < w[1]), "{}: an id twice", scheme.name());
    let two_axes = scheme != Scheme::S3d;
    let heights = held.iter().flatten().fold(Aabb::EMPTY, |all, b| all.union(*b));
    for (id, b) in (0..).zip(held) {
        let was_found = ids.binary_search(&id).is_ok();
        let Some(b) = b else {
            assert!(!was_found, "{}: {id} was removed", scheme.name());
            continue;
        };
        let stored = index.bounds_of(id);
        let holds = stored.is_some_and(|s| s.min.cmple(b.min).all() && s.max.cmpge(b.max).all());
        assert!(holds, "{}: {id} is stored as {stored:?}", scheme.name());
        if must_be_found(query, region, b) {
            assert!(was_found, "{}: {id} at {b:?} is missing", scheme.name());
        }
        if was_found && let Some(mut near) = stored {
            let slack = 1e-6 + 1e-12 * near.max.abs().max_element();
            (near.min, near.max) = (near.min - slack, near.max + slack);
            if two_axes {
                // These schemes do not index heights, and their overall heights still include removed boxes.
                (near.min.z, near.max.z) = (heights.min.z - 1e3, heights.max.z + 1e3);
            }
            assert!(region.meets(&near), "{}: {id} at {near:?} should not be found", scheme.name());
        }
    }
}

#[derive(Clone, Debug)]
enum Step {
    Insert(usize, usize),
    Remove(usize),
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        3 => (any::<prop::sample::Index>(), any::<prop::sample::Index>())
            .prop_map(|(i, j)| Step::Insert(i.index(400), j.index(1 << 20))),
        2 => any::<prop::sample::Index>().prop_map(|i| Step::Remove(i.index(400))),
    ];
    prop::collection::vec(step, 0..400)
}

fn params() -> impl Strategy<Value = Params> {
    let split_axis = prop_oneof![Just(SplitAxis::Longest), Just(SplitAxis::Alternating)];
    (prop_oneof![Just(0.0), Just(0.5), Just(20.0)], prop_oneof![Just(1usize), Just(8), Just(32)], split_axis)
        .prop_map(|(min_cell, cell_polygons, split_axis)| Params { min_cell, cell_polygons, split_axis, filter: true })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    /// Mainly points at the rim of a radius, where bounds could be too small.
    #[test]
    fn bounds_hold_what_regions_contain(
        query in queries(), places in prop::collection::vec((point(), prop_oneof![0.0..60.0f64, Just(1.0)]), 100),
    ) {
        let region = query.at(0.0);
        let bounds = region.bounds();
        let reach = bounds.half_extent().x;
        let reach = if reach.is_finite() { reach * (1.0 - 1e-12) } else { 50.0 };
        for (p, far) in places {
            let by = if far == 1.0 { p.normalize_or(DVec3::X) * reach } else { p.normalize_or(DVec3::X) * far };
            let p = region.origin() + by;
            let slack = 1e-12 * p.abs();
            let held = p.cmpge(bounds.min - slack).all() && p.cmple(bounds.max + slack).all();
            prop_assert!(held || !region.contains(p), "{p:?} is out of {bounds:?}");
        }
    }

    #[test]
    fn fresh_indexes_find_what_brute_force_finds(
        boxes in boxes(), queries in prop::collection::vec(queries(), 8), params in params(),
    ) {
        let far = boxes.first().map_or(0.0, |b| (b.min.x / 1e6).round() * 1e6);
        let held: Vec<Option<Aabb>> = boxes.iter().copied().map(Some).collect();
        let items: Vec<(u32, Aabb)> = (0..).zip(boxes).collect();
        for scheme in FLAT {
            let index = scheme.build(params, &items).unwrap();
            index.assert_well_formed();
            assert_eq!(index.len(), items.len());
            for query in &queries {
                check(index.as_ref(), scheme, &held, *query, far);
            }
        }
    }

    #[test]
    fn changed_indexes_find_what_brute_force_finds(
        boxes in boxes(), steps in steps(), queries in prop::collection::vec(queries(), 4), params in params(),
    ) {
        prop_assume!(!boxes.is_empty());
        let far = (boxes[0].min.x / 1e6).round() * 1e6;
        for scheme in FLAT {
            let mut held = vec![None; 400];
            let items: Vec<(u32, Aabb)> = (0..).zip(boxes.iter().copied()).take(boxes.len() / 2).collect();
            for (id, b) in &items {
                held[*id as usize] = Some(*b);
            }
            let mut index = scheme.build(params, &items).unwrap();
            for step in &steps {
                match *step {
                    Step::Insert(id, which) => {
                        let b = boxes[which % boxes.len()];
                        index.insert(id as u32, &b);
                        held[id] = Some(b);
                    }
                    Step::Remove(id) => {
                        let was = held[id].take().is_some();
                        prop_assert_eq!(index.remove(id as u32), was);
                    }
                }
                index.assert_well_formed();
            }
            for query in &queries {
                check(index.as_ref(), scheme, &held, *query, far);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// All schemes, over an environment in which objects are inserted, moved and deleted.
    #[test]
    fn worlds_keep_their_index_in_step(
        places in prop::collection::vec((point(), -4.0..4.0f64, -1.0..1.0f64, 0.2..3.0f64), 1..20),
        moves in prop::collection::vec((any::<prop::sample::Index>(), point(), any::<bool>()), 0..20),
        queries in prop::collection::vec(queries(), 4),
    ) {
        let mesh = bowl();
        for scheme in Scheme::ALL {
            let mut world = World::with_index(Environment::new(), &scheme.kind(Params::default()));
            world.apply(Change::AddMaterial(Material::named("m"))).unwrap();
            for (p, yaw, roll, scale) in &places {
                let mut new = NewObject::new("bowl", Pose::from_xyz_rpy(*p, *roll, 0.0, *yaw), mesh.clone());
                new.object_from_mesh = DAffine3::from_scale(DVec3::new(*scale, -1.0, 1.0));
                world.apply(Change::InsertObject(new)).unwrap();
            }
            let before = world.clone();
            for (which, p, delete) in &moves {
                let name = world.environment().objects()[which.index(places.len())].name.clone();
                let change = if *delete {
                    Change::DeleteObject { name }
                } else {
                    Change::MoveObject { name, world_from_object: Pose::from_xyz_rpy(*p, 0.1, 0.2, 0.3) }
                };
                // A repeated deletion is refused.
                let _ = world.apply(change);
                world.index().assert_well_formed(world.environment());
            }
            before.index().assert_well_formed(before.environment());
            for query in &queries {
                check_world(&world, scheme, &query.at(0.0));
            }
        }
    }
}

/// A mesh of a few clusters.
fn bowl() -> Arc<Mesh> {
    let side = 16u32;
    let vertex = |i: u32| {
        let (x, y) = ((i % (side + 1)) as f32 / 4.0 - 2.0, (i / (side + 1)) as f32 / 4.0 - 2.0);
        Vec3::new(x, y, 0.2 * (x * x + y * y))
    };
    let faces = (0..side * side).flat_map(|i| {
        let a = i / side * (side + 1) + i % side;
        [vec![a, a + 1, a + side + 1], vec![a + 1, a + side + 2, a + side + 1]].map(|c| Polygon::new(c, 0))
    });
    let vertices = (0..(side + 1) * (side + 1)).map(vertex).collect();
    Arc::new(Mesh::new("bowl", vertices, faces.collect(), PolygonOrder::Spatial).unwrap())
}

fn check_world(world: &World, scheme: Scheme, region: &Region) {
    let (environment, name) = (world.environment(), scheme.name());
    let mut found = QueryResult::default();
    world.index().query(environment, region, &mut found);
    let mut slots: Vec<u32> = found.all().collect();
    slots.sort_unstable();
    assert!(slots.windows(2).all(|w| w[0] < w[1]), "{name}: a slot twice");
    let mut runs = Vec::new();
    world.index().select(environment, region, &mut found, &mut runs);
    let mut selected: Vec<u32> = Vec::new();
    for run in &runs {
        let first = environment.objects()[run.object as usize].first_slot + run.first;
        selected.extend(first..first + run.count);
        let clusters = environment.objects()[run.object as usize].mesh.clusters();
        let within = clusters.iter().any(|c| c.first <= run.first && run.first + run.count <= c.first + c.count);
        assert!(within, "{name}: a run over two clusters");
    }
    let total = selected.len();
    selected.sort_unstable();
    selected.dedup();
    assert_eq!(total, selected.len(), "{name}: a polygon in two runs");
    for slot in 0..environment.slot_count() {
        let Some(corners) = environment.polygon_in_world(slot) else { continue };
        if corners.iter().any(|p| region.contains(*p)) {
            assert!(slots.binary_search(&slot).is_ok(), "{name}: {slot} is missing");
            assert!(selected.binary_search(&slot).is_ok(), "{name}: {slot} is not selected");
        }
    }
}

/// Planted fault: an index that does not find one of its ids is caught.
#[test]
#[should_panic(expected = "is missing")]
fn a_lost_id_is_noticed() {
    let b = Aabb::of([DVec3::ZERO, DVec3::ONE]);
    let index = Scheme::S3d.build(Params::default(), &[(0, b), (1, b)]).unwrap();
    let query = Query::Sector(DVec3::ZERO, 0.0, TAU, 10.0);
    check_found(vec![0], index.as_ref(), Scheme::S3d, &[Some(b), Some(b)], (query, &query.at(0.0)));
}

/// A giant floor with 100,000 screws: queries and memory stay small.
#[test]
fn a_floor_with_screws_stays_cheap() {
    let screws = (0..100_000u32).map(|i| {
        let p = DVec3::new(f64::from(i % 316), f64::from(i / 316), 0.0) * 0.3;
        (i, Aabb { min: p, max: p + 0.01 })
    });
    let floor = Aabb { min: DVec3::splat(-1.0), max: DVec3::new(200.0, 200.0, 0.0) };
    let items: Vec<(u32, Aabb)> = screws.chain([(100_000, floor)]).collect();
    for scheme in FLAT {
        let index = scheme.build(scheme.params(), &items).unwrap();
        index.assert_well_formed();
        let mut found = QueryResult::default();
        index.query(&Region::sector(DVec2::new(50.0, 50.0), 0.0, PI / 3.0, 10.0), &mut found);
        assert!(found.ids.contains(&100_000));
        let per_id = index.bytes() as f64 / items.len() as f64;
        assert!(per_id < 80.0, "{}: {per_id} bytes an id", scheme.name());
        assert!(found.tested + found.visited < 4000, "{}: {} + {}", scheme.name(), found.tested, found.visited);
        // 52 m^2 of 11 screws each.
        assert!((500..700).contains(&found.count()), "{}: {} found", scheme.name(), found.count());
    }
}

/// After 100,000 random changes, a tree answers nearly as fast as a fresh one.
#[test]
fn trees_stay_balanced() {
    let mut state = 1u64;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1u64 << 31) as f64
    };
    let mut place = move || {
        let p = DVec3::new(random() * 100.0, random() * 100.0, random() * 5.0);
        Aabb { min: p, max: p + DVec3::new(random(), random(), random()) * 0.4 }
    };
    let mut held: Vec<(u32, Aabb)> = (0..20_000).map(|i| (i, place())).collect();
    for scheme in FLAT {
        let mut index = scheme.build(scheme.params(), &held).unwrap();
        for i in 0..100_000u32 {
            let id = i.wrapping_mul(7919) % 20_000;
            let b = place();
            // Half of them are removed first.
            if i % 2 == 0 {
                index.remove(id);
            }
            index.insert(id, &b);
            held[id as usize].1 = b;
        }
        index.assert_well_formed();
        let fresh = scheme.build(scheme.params(), &held).unwrap();
        let work = |index: &dyn SpatialIndex| {
            let mut found = QueryResult::default();
            for i in 0..200 {
                let apex = DVec2::new(f64::from(i % 20) * 5.0, f64::from(i / 20) * 10.0);
                index.query(&Region::sector(apex, f64::from(i), PI / 3.0, 10.0), &mut found);
            }
            (found.visited + found.tested) as f64
        };
        let ratio = work(index.as_ref()) / work(fresh.as_ref());
        assert!(ratio < 1.3, "{}: {ratio} times the work of a fresh one", scheme.name());
    }
}

#[test]
fn schemes_are_named() {
    for scheme in Scheme::ALL {
        assert_eq!(scheme.name().parse::<Scheme>().unwrap(), scheme);
        assert_eq!(World::with_index(Environment::new(), &scheme.tuned()).index().name(), scheme.name());
    }
    assert!("r-tree".parse::<Scheme>().is_err());
}
