//! The CPU twin of the stage, and the test that compares the two.

use super::*;
use crate::gpu::layout::{Params, RECORD_WORDS, Record, Slot};
use crate::gpu::near::STAMPED;
use crate::gpu::{DeviceOptions, GpuEngine, testing};
use glam::{DQuat, Vec3};
use presight_model::random::SplitMix64;
use presight_model::sensor::{Angles, Camera, Geometry, Scanner, SensorSpec};
use presight_model::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder, Pose, World};
use presight_render::plan::{FramePlan, ImageRequest, Images, Stats};
use presight_testkit::skip::no_adapter;
use std::collections::BTreeSet;
use std::mem::offset_of;
use std::sync::Arc;

/// The buffers that the last frame left on the device.
struct LastFrame {
    params: Params,
    scanner: bool,
    keys: Vec<[u32; 2]>,
    slots: Vec<Slot>,
    records: Vec<u32>,
}

impl LastFrame {
    fn word3(&self, at: usize) -> [f32; 3] {
        [0, 1, 2].map(|i| f32::from_bits(self.records[at + i]))
    }

    fn covers(&self, record: usize, place: [f32; 3]) -> bool {
        let first = record + RECORD_WORDS as usize;
        (0..self.records[record + offset_of!(Record, edge_count) / 4] as usize)
            .all(|k| !(dot(self.word3(first + 3 * k), place) < 0.0))
    }

    fn answer(&self, asked: &[u32], at: usize) -> u32 {
        let (w, h) = (i64::from(self.params.width), i64::from(self.params.height));
        let place = [0, 1, 2].map(|i| f32::from_bits(asked[at + i]));
        let (column, row) = (i64::from(asked[at + 3]) % w, i64::from(asked[at + 3]) / w);
        let own = asked[at + 4] as usize;
        let own = &asked[own + 1..][..asked[own] as usize];
        let (mut best, mut by, mut covered, mut beside) = (1.0f32, DOUBT, false, false);
        for (r, c) in (row - 1..=row + 1).flat_map(|r| (column - 1..=column + 1).map(move |c| (r, c))) {
            let c = if asked[1] != 0 { c.rem_euclid(i64::from(asked[1])) } else { c };
            if !(0..h).contains(&r) || !(0..w).contains(&c) {
                continue;
            }
            let [id, bits] = self.keys[if self.scanner { c * h + r } else { r * w + c } as usize];
            if id == 0 || bits == 0 {
                continue;
            }
            let record = self.slots[!id as usize].record;
            if record >= STAMPED {
                beside = true;
                continue;
            }
            let share = dot(self.word3(record as usize), place);
            let holds = self.covers(record as usize, place);
            if own.contains(&!id) {
                covered |= holds;
            } else if holds && share > best {
                (best, by) = (share, !id);
            } else {
                covered |= holds;
                beside |= !holds && share > 1.0;
            }
        }
        if by == DOUBT && covered && !beside { SEEN } else { by }
    }

    fn answers(&self, asked: &OcclusionQuery) -> Vec<OcclusionHint> {
        let all = (0..asked.count as usize).map(|i| self.answer(&asked.words, SAMPLES_AT + i * SAMPLE_WORDS));
        all.map(hint_of_word).collect()
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Reads back a whole buffer as words.
fn words(engine: &GpuEngine, buffer: &Growable) -> Vec<u32> {
    let bytes = buffer.buffer().size();
    let mut to = Answers::new(&engine.gpu, "test");
    to.reserve(&engine.gpu, bytes).unwrap();
    let mut encoder = engine.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(buffer.buffer(), 0, to.buffer(), 0, bytes);
    engine.gpu.queue.submit([encoder.finish()]);
    bytemuck::pod_collect_to_vec(&to.wait(&engine.gpu, bytes).unwrap())
}

/// Random test cases.
struct Random(SplitMix64);

impl Random {
    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.unit()
    }

    fn place(&mut self, most: DVec3) -> DVec3 {
        DVec3::new(self.uniform(-most.x, most.x), self.uniform(-most.y, most.y), self.uniform(-most.z, most.z))
    }
}

/// Triangles of many sizes around the sensor, including slivers and edge-on ones.
fn hard(random: &mut Random) -> World {
    let mut environment = Environment::new();
    environment.add_material(Material::named("grey")).unwrap();
    for _ in 0..400 {
        let at = random.place(DVec3::new(8.0, 8.0, 3.0));
        let size = 10f64.powf(random.uniform(-2.0, 0.7));
        let thin = if random.uniform(0.0, 1.0) < 0.3 { 1e-3 } else { 1.0 };
        let corners = [DVec3::ZERO, DVec3::X, DVec3::new(0.3, thin, 0.0)].map(|p| (p * size).as_vec3());
        let corners: Vec<Vec3> = corners.to_vec();
        let mesh = Mesh::new("t", corners, vec![Polygon::new(vec![0, 1, 2], 0)], PolygonOrder::Given).unwrap();
        let axis = random.place(DVec3::ONE).normalize_or(DVec3::X);
        let pose = Pose::new(at, DQuat::from_axis_angle(axis, random.uniform(-3.0, 3.0))).unwrap();
        environment.insert(NewObject::new("t", pose, Arc::new(mesh))).unwrap();
    }
    World::new(environment)
}

fn sensors() -> [Sensor; 4] {
    let camera = |distortion| Camera { distortion, ..Camera::pinhole(97, 61, 80.0, 84.0, 47.0, 31.0) };
    let beams = |start_deg, step_deg, count| Angles::Uniform { start_deg, step_deg, count };
    let scanner = Scanner { azimuth: beams(-180.0, 2.5, 144), elevation: beams(-30.0, 2.0, 31), beam_height_deg: None };
    let twice = Scanner { azimuth: beams(-180.0, 2.5, 145), ..scanner.clone() };
    [
        Geometry::Camera(camera(presight_model::Distortion::None)),
        Geometry::Scanner(scanner),
        Geometry::Scanner(twice),
        Geometry::Camera(camera(presight_model::Distortion::PlumbBob([-0.2, 0.05, 1e-3, 0.0, 0.0]))),
    ]
    .map(|geometry| Sensor::new(SensorSpec::new("s", "laser", geometry)).unwrap())
}

#[test]
fn the_device_answers_as_its_twin() {
    for without_int64 in [false, true] {
        let options = DeviceOptions { without_int64, ..Default::default() };
        let mut engine = match testing::open(options, testing::Setup::ALL_ON_DEVICE) {
            Ok(engine) => engine,
            Err(e) => {
                no_adapter(e);
                return;
            }
        };
        let mut random = Random(SplitMix64(if without_int64 { 5 } else { 4 }));
        for sensor in sensors() {
            let world = hard(&mut random);
            let pose = Pose::from_xyz_rpy(random.place(DVec3::splat(0.3)), 0.1, 0.05, random.uniform(-3.0, 3.0));
            let plan = FramePlan::new(&world, &sensor, &pose, ImageRequest::default()).unwrap();
            engine.render(&plan, &mut Images::default(), &mut Stats::default()).unwrap();
            let mut asked = OcclusionQuery::with_room(4000, &sensor);
            while asked.count() < 4000 {
                if asked.count().is_multiple_of(50) {
                    let own = random.uniform(0.0, 400.0) as u32;
                    asked.begin(&[own, own / 2][..(own % 3) as usize]);
                }
                let (u, v) = (
                    random.uniform(-0.5, f64::from(sensor.width()) - 0.5),
                    random.uniform(-0.5, f64::from(sensor.height()) - 0.5),
                );
                let Some(ray) = sensor.ray_at(u, v) else { continue };
                let pixel = ((v + 0.5) as u32) * sensor.width() + (u + 0.5) as u32;
                asked.push(ray * 10f64.powf(random.uniform(-0.5, 1.2)), pixel);
            }
            let answers = engine.query_occlusion(&asked).unwrap();
            let pairs = |words: Vec<u32>| words.chunks_exact(2).map(|w| [w[0], w[1]]).collect();
            let mut left = LastFrame {
                params: engine.frames[0].params,
                scanner: engine.sensors[0].tables.kind == GridKind::Scanner,
                keys: pairs(words(&engine, &engine.store.keys)),
                slots: bytemuck::pod_collect_to_vec(&words(&engine, &engine.store.seen_slots)),
                records: words(&engine, &engine.store.records),
            };
            let twin = left.answers(&asked);
            let differing = |twin: &[OcclusionHint]| answers.iter().zip(twin).filter(|(a, b)| a != b).count();
            let count = |what: fn(&OcclusionHint) -> bool| answers.iter().filter(|a| what(a)).count();
            let hidden = count(|a| matches!(a, OcclusionHint::Hidden(_)));
            let seen = count(|a| *a == OcclusionHint::Seen);
            let ties = differing(&twin);
            eprintln!("{hidden} hidden, {seen} seen of {}, {ties} otherwise than the twin", answers.len());
            assert!(hidden > 100 && seen > 100 && hidden + seen < 3990, "{hidden} {seen}");
            // The device may fuse products of three terms: answers may differ within 2^-22 of an edge or of a range.
            assert!(ties <= 4, "{ties}");
            // A planted fault: flip the planes of all polygons in the image. Other slots may be stale.
            let pixels = (sensor.width() * sensor.height()) as usize;
            let shown = left.keys[..pixels].iter().filter(|[id, bits]| *id != 0 && *bits != 0);
            let records: BTreeSet<u32> = shown.map(|[id, _]| left.slots[!id as usize].record).collect();
            for record in records.into_iter().filter(|r| *r < STAMPED) {
                left.records[record as usize..][..3].iter_mut().for_each(|word| *word ^= STAMPED);
            }
            assert!(differing(&left.answers(&asked)) > 100);
        }
    }
}
