//! Real scans of a street as points (../shared/data/lidar3d): two of them in the surface of the first.

use super::*;
use presight::estimate::{Estimate, Prior};
use presight::io::gltf::import;
use presight::io::log::{Frames, Observation};

fn map() -> Option<World> {
    let path = presight_testkit::data::file("lidar3d/street_map.glb")?;
    Some(World::new(import(path, &Default::default()).unwrap().environment))
}

fn scans() -> Vec<Observation> {
    let path = presight_testkit::data::file("lidar3d/street_map.glb").unwrap();
    Frames::open(path.parent().unwrap(), None, &Default::default()).unwrap().map(|o| o.unwrap()).collect()
}

/// Median of the differences between sensed and predicted ranges, metres.
fn residual(estimate: &Estimate) -> f32 {
    let differences = estimate.verdicts[0].difference.iter().filter(|d| !d.is_nan());
    let mut off: Vec<f32> = differences.map(|d| d.abs()).collect();
    off.sort_unstable_by(f32::total_cmp);
    off[off.len() / 2]
}

#[test]
fn scans_are_found_in_the_surface_of_the_first() {
    let Some(map) = map() else { return };
    let scans = scans();
    assert_eq!(scans.len(), 3);
    let mut random = Random(5);
    let draws = presight_testkit::env_number("PRESIGHT_STREET_DRAWS", 20);
    for (k, metres, degrees, at_reference, most) in [(1, 0.04, 0.25, 0.10, 0.09), (2, 0.12, 0.5, 0.24, 0.20)] {
        let Observation { frame, reference } = &scans[k];
        let reference = reference.unwrap();
        let there = estimator(EstimateOptions::scan()).estimate(&map, &[frame], &Prior::of_sigmas(reference, 1e-6, 1e-6)).unwrap();
        let here = estimator(EstimateOptions::scan()).estimate(&map, &[frame], &Prior::of_sigmas(reference, 0.1, 0.02)).unwrap();
        eprintln!(
            "scan {k}: at the reference {} here {} {:?} {:?}",
            residual(&there),
            residual(&here),
            apart(&here.pose, &reference),
            here.state
        );
        let mut starts = vec![Pose::IDENTITY];
        starts.extend((0..draws).map(|_| off_by(&reference, 1.0, 15.0, &mut random)));
        for (i, start) in starts.iter().enumerate() {
            let prior = Prior::of_sigmas(*start, 0.6, 0.15);
            let time = std::time::Instant::now();
            let found = estimator(EstimateOptions::scan()).estimate(&map, &[frame], &prior).unwrap();
            let (m, d) = apart(&found.pose, &reference);
            eprintln!(
                "{k} {i}: {m:.4} {d:.3} {:.3} {:.2} {} {:?} {:?}",
                residual(&found),
                found.explained,
                found.predictions,
                found.state,
                time.elapsed()
            );
        }
        let _ = (metres, degrees, at_reference, most);
    }
}
