//! The living room, explored from its even frames and judged on its odd ones.
use presight_explore::{ExploreOptions, Surfaces, Views};
use presight_files::log::Frames;

#[test]
fn room() {
    let log = presight_testkit::data::file("rgbd/livingroom").unwrap();
    let (mut even, mut odd) = (Views::default(), Views::default());
    let clock = std::time::Instant::now();
    for (k, o) in Frames::open(&log, None, &Default::default()).unwrap().enumerate() {
        let o = o.unwrap();
        let frame = o.frame.thinned(4).unwrap();
        let to = if k % 2 == 0 { &mut even } else if (k / 2) % 4 == 0 { &mut odd } else { continue };
        to.push(&frame, o.reference.unwrap()).unwrap();
    }
    eprintln!("read in {:.2} s", clock.elapsed().as_secs_f64());
    let n: usize = std::env::var("POLYGONS").map_or(2000, |v| v.parse().unwrap());
    let clock = std::time::Instant::now();
    let found = Surfaces::of(&even, &ExploreOptions::default().with_polygons(n)).unwrap();
    eprintln!("explored in {:.2} s: {} polygons, {:?}", clock.elapsed().as_secs_f64(), found.polygons(), found.areas);
    eprintln!("{:?}", found.judged(&odd).unwrap());
}
