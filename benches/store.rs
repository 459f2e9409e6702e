//! The stored environment: moves a second including the disk, and opening the hospital next to its indispensable parts.

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use glam::{DVec3, Vec3};
use presight_model::change::Change;
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use presight_model::index::{IndexKind, WorldIndex};
use presight_store as store;
use presight_store::{Note, Store};
use std::path::{Path, PathBuf};
use std::sync::Arc;

const OBJECTS: usize = 1000;
/// Moves that become durable together.
const TOGETHER: usize = 100;

/// Objects of 48 polygons each; ten of them share a mesh.
fn machines() -> Environment {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).expect("sound");
    let mut mesh = None;
    for i in 0..OBJECTS {
        if i % 10 == 0 {
            let mut vertices = Vec::new();
            let mut polygons = Vec::new();
            for k in 0..48u32 {
                let z = k as f32 * 0.1 + i as f32 * 1e-3;
                vertices.extend([Vec3::new(0.0, 0.0, z), Vec3::new(1.0, 0.0, z), Vec3::new(0.0, 1.0, z)]);
                polygons.push(Polygon::new(vec![3 * k, 3 * k + 1, 3 * k + 2], 0));
            }
            mesh = Some(Arc::new(Mesh::new("machine", vertices, polygons, PolygonOrder::Spatial).expect("sound")));
        }
        let mesh = mesh.clone().expect("the first object made a mesh");
        let new = NewObject::new(format!("hall/machine {i}"), Pose::IDENTITY, mesh);
        environment.insert(new).expect("it fits");
    }
    environment
}

fn moves(c: &mut Criterion) {
    // On the disk of the build folder, not in memory.
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).expect("a folder");
    let path = folder.path().join("moves.presight");
    store::create(&path, &machines(), &Note::new("bench", 0.0)).expect("a store");
    let mut store = Store::open(&path).expect("it opens");
    let mut random = 1u64;
    let mut group = c.benchmark_group("store");
    group.sample_size(20).throughput(Throughput::Elements(TOGETHER as u64));
    group.bench_function("100 moves, one transaction", |b| {
        b.iter(|| {
            let mut batch = store.batch().expect("no other writer");
            for _ in 0..TOGETHER {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let name = format!("hall/machine {}", (random >> 33) as usize % OBJECTS);
                let at = DVec3::new((random >> 40) as f64 * 1e-5, (random >> 50) as f64 * 1e-3, 0.0);
                let pose = Pose::from_xyz_rpy(at, 0.0, 0.0, (random >> 44) as f64 * 1e-6);
                let change = Change::MoveObject { name, world_from_object: pose };
                batch.apply(change, &Note::new("bench", 1.0)).expect("it moves");
            }
            batch.commit().expect("a successful commit");
        });
    });
    group.finish();
}

fn hospital() -> Option<PathBuf> {
    let root = std::env::var_os("PRESIGHT_DATA")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    Some(root.join("env/hospital.glb")).filter(|path| path.exists())
}

fn opening(c: &mut Criterion) {
    let Some(scene) = hospital() else { return };
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).expect("a folder");
    let path: &Path = &folder.path().join("hospital.presight");
    let environment = presight_read::gltf::import(scene, &Default::default()).expect("it imports").environment;
    store::create(path, &environment, &Note::new("bench", 0.0)).expect("a store");
    let kind = IndexKind::default();
    let mut group = c.benchmark_group("hospital");
    group.sample_size(20);
    group.bench_function("bytes of the store", |b| b.iter(|| std::fs::read(path).expect("the store exists").len()));
    group.bench_function("index", |b| {
        b.iter_batched(|| (), |()| WorldIndex::new(&environment, &kind), BatchSize::PerIteration);
    });
    group.bench_function("open, with the index", |b| {
        b.iter(|| store::read_world(path, &kind).expect("it is sound"));
    });
    group.finish();
}

criterion_group!(benches, moves, opening);
criterion_main!(benches);
