//! Clouds of lidars on a robot that drives, as drivers write them: their points lie on the walls once the motion is
//! undone.
#![allow(clippy::print_stdout, reason = "tests print their figures on request")]

use glam::DVec3;
use presight_model::caster::RayCaster;
use presight_model::geometry::{Pose, Twist};
use presight_model::measured::{Frame, ScanMotion};
use presight_model::statistics::{median, tail};
use presight_model::world::World;
use presight_read::gltf::{ImportOptions, import};
use presight_read::log::Frames;
use presight_testkit::data;

/// Share of the points of a frame that are farther than 1 cm from every surface, the robot being at a pose.
fn share_off(caster: &RayCaster, frame: &Frame, robot: &Pose) -> f64 {
    let sensor = frame.sensor();
    let world_from_body = *robot * sensor.spec().mount;
    let points = (0..).zip(frame.ranges()).filter(|(_, range)| range.is_finite());
    let (mut count, mut off) = (0, 0);
    for (i, range) in points {
        let (c, r) = (i % sensor.width(), i / sensor.width());
        let ray: DVec3 = sensor.body_from_image() * sensor.ray(c, r).expect("a measured pixel has a ray");
        let p = world_from_body.transform_point(sensor.origin(c, r) + ray * f64::from(*range));
        count += 1;
        off += usize::from(caster.nearest(p, 0.01).is_none());
    }
    assert!(count > 3000, "{count} points");
    off as f64 / f64::from(count)
}

/// Standard deviation of the ranges of a frame against the model, metres; robust against rays past edges. Only the first
/// tenth of the scan and the last count: the robot's pose is known there, whatever its speed between.
fn range_sigma(caster: &RayCaster, raw: &Frame, robot: &Pose) -> f64 {
    let (still, last) = (raw.deskewed(0.0).unwrap(), raw.sensor().scan_interval()[1]);
    let (sensor, world_from_body) = (still.sensor(), *robot * still.sensor().spec().mount);
    let mut off = Vec::new();
    for (i, range) in (0..).zip(still.ranges()).filter(|(_, range)| range.is_finite()) {
        let (c, r) = (i % sensor.width(), i / sensor.width());
        if (raw.sensor().seconds_after_stamp(c, r) / last - 0.5).abs() < 0.4 {
            continue;
        }
        let ray: DVec3 = sensor.body_from_image() * sensor.ray(c, r).expect("a measured pixel has a ray");
        let origin = world_from_body.transform_point(sensor.origin(c, r));
        let hit = caster.cast(origin, world_from_body.rotation * ray, 100.0, None);
        off.extend(hit.map(|hit| (hit.range - f64::from(*range)).abs()));
    }
    // Half of a normal distribution is within 0.6745 standard deviations.
    median(&mut off).expect("hits") / 0.6745
}

/// Ouster's clouds are organized and have nanoseconds, Velodyne's are not and have seconds.
#[test]
fn clouds_of_a_moving_robot_lie_on_the_walls() {
    let Some(bags) = data::file("ros") else { return };
    let scene = data::root().join("scenes/room.glb");
    let world = World::new(import(&scene, &ImportOptions::default()).unwrap().environment);
    let caster = RayCaster::new(&world, "laser");
    for (name, words) in [("ouster_points.mcap", "nanoseconds"), ("velodyne_points.mcap", ": seconds")] {
        let mut log = Frames::open(&bags.join(name), None, &Default::default()).unwrap();
        let frames: Vec<_> = log.by_ref().map(Result::unwrap).collect();
        let notices = log.notices().join("\n");
        assert!(notices.contains(words) && notices.contains("counted from the stamp"), "{name}: {notices}");
        // The second scan begins at the last transform.
        assert!(notices.contains("does not reach over every scan"), "{name}: {notices}");
        assert_eq!(frames.len(), 2);
        // The ranges have noise: a point is at most as far from the walls as its range is off.
        let first = &frames[0];
        let sigma = range_sigma(&caster, &first.frame, &first.reference.unwrap().world_from_robot());
        let noisy = 2.0 * tail(0.01 / sigma);
        let by_chance = 3.0 * (noisy * (1.0 - noisy) / 3000.0).sqrt();
        println!("{name}: ranges with {:.1} mm of noise, {:.1} % off by over 1 cm", 1e3 * sigma, 100.0 * noisy);
        assert!((0.004..0.006).contains(&sigma), "{name}: {sigma}");
        // Beyond the last transform its velocity is extended, but the robot accelerates.
        for (o, max_off) in frames.iter().zip([noisy + by_chance, 0.3]) {
            let robot = o.reference.unwrap().world_from_robot();
            let interval = o.frame.sensor().scan_interval();
            assert!(interval[0] == 0.0 && (0.0995..0.0998).contains(&interval[1]), "{interval:?}");
            let still = share_off(&caster, &o.frame.deskewed(0.0).unwrap(), &robot);
            let raw = share_off(&caster, &o.frame, &robot);
            println!(
                "{name} at {} s: {:.2} % off by over 1 cm, {:.1} % as measured",
                o.frame.stamp,
                100.0 * still,
                100.0 * raw
            );
            assert!(still < max_off && raw > 0.5, "{name}: {still} {raw}");
            // Planted: the robot's twist along the world's axes.
            let Some(ScanMotion::Twist(twist)) = o.frame.scan_motion() else { panic!("{:?}", o.frame.scan_motion()) };
            let in_world = Twist::new(robot.rotation * twist.linear, robot.rotation * twist.angular);
            let planted = o.frame.clone().with_scan_motion(ScanMotion::Twist(in_world)).deskewed(0.0).unwrap();
            let planted = share_off(&caster, &planted, &robot);
            assert!(planted > still + 0.08, "{name}: {planted}, {still} by the true twist");
        }
    }
}
