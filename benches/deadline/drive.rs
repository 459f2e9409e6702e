//! Draws the time of each frame of a drive as SVG, with and without control (paper, Fig. 12).

use super::{Bench, Outcome, Setting, quantile};
use plotters::prelude::*;
use presight_model::error::ErrorKind;
use presight_model::geometry::Pose;
use presight_predict::free_poses::free_poses;
use std::path::Path;

/// The name, the value at each frame, and the colour.
type Line = (&'static str, fn(&Frame) -> f64, RGBColor);

/// The number of free poses on the drive, and of frames from each to the next.
const STOPS: usize = 12;
const FRAMES: usize = 25;

/// A chart's height relative to its curves: leaves room for the legend above them.
const ROOM: f64 = 1.5;

/// A frame of the drive.
#[derive(Clone, Copy, Default)]
struct Frame {
    /// Milliseconds without control and with it.
    without: f64,
    with: f64,
    /// Metres; infinite if nothing was cut.
    radius: f64,
    complete_to: f64,
    stride: u32,
    refused: bool,
}

pub fn draw(args: &[String], setting: &Setting) -> Outcome {
    let mut bench = Bench::new(&args[0], args.get(2), setting)?;
    let poses = drive(free_poses(&bench.world, STOPS, 7)?);
    // The controller learns on the way. The time without control is the median of three.
    let mut frames = vec![Frame::default(); poses.len()];
    for (frame, pose) in frames.iter_mut().zip(&poses) {
        let times: Vec<f64> = (0..3).map(|_| bench.frame(pose, None).0).collect();
        frame.without = quantile(&times, 0.5);
        bench.frame(pose, Some(1e6)).1?;
    }
    let deadline = quantile(&frames.iter().map(|frame| frame.without).collect::<Vec<_>>(), 0.5);
    for (frame, pose) in frames.iter_mut().zip(&poses) {
        let (took, answer) = bench.frame(pose, Some(deadline));
        (frame.with, frame.radius, frame.complete_to, frame.stride) = (took, f64::INFINITY, f64::INFINITY, 1);
        match answer {
            Ok(stats) => {
                if let Some(given_up) = stats.degradation() {
                    let cut = given_up
                        .means
                        .iter()
                        .find(|taken| taken.means == presight_render::deadline::DegradationKind::Radius);
                    frame.radius = cut.and_then(|taken| taken.metres).unwrap_or(f64::INFINITY);
                    (frame.complete_to, frame.stride) = (given_up.complete_to, given_up.stride);
                }
            }
            Err(e) if e.kind() == ErrorKind::Deadline => frame.refused = true,
            Err(e) => return Err(e.into()),
        }
    }
    let missed = |time: fn(&Frame) -> f64| frames.iter().filter(|frame| time(frame) > deadline).count();
    println!(
        "{} frames, deadline {deadline:.2} ms: missed by {} without control, by {} with it; {} refused",
        frames.len(),
        missed(|frame| frame.without),
        missed(|frame| frame.with),
        frames.iter().filter(|frame| frame.refused).count()
    );
    chart(Path::new(&args[1]), &frames, deadline, bench.sensor.spec().range_max)
}

/// Goes from each stop straight to the nearest remaining one, looking ahead. Walls do not block it.
fn drive(mut stops: Vec<Pose>) -> Vec<Pose> {
    let mut poses = Vec::new();
    let mut at = stops.swap_remove(0);
    while !stops.is_empty() {
        let distance = |stop: &Pose| (stop.translation - at.translation).length();
        let next = (0..stops.len()).min_by(|a, b| distance(&stops[*a]).total_cmp(&distance(&stops[*b]))).unwrap_or(0);
        let next = stops.swap_remove(next);
        let along = next.translation - at.translation;
        let heading = along.y.atan2(along.x);
        poses.extend(
            (0..FRAMES)
                .map(|i| Pose::from_xyz_rpy(at.translation + along * (i as f64 / FRAMES as f64), 0.0, 0.0, heading)),
        );
        at = next;
    }
    poses
}

fn chart(path: &Path, frames: &[Frame], deadline: f64, range_max: f64) -> Outcome {
    let root = SVGBackend::new(path, (1000, 760)).into_drawing_area();
    root.fill(&WHITE)?;
    let areas = root.split_evenly((3, 1));
    let number = |values: fn(&Frame) -> f64| frames.iter().enumerate().map(move |(i, frame)| (i as f64, values(frame)));
    let most = frames.iter().map(|frame| frame.without.max(frame.with)).fold(deadline, f64::max);
    let lines: [Line; 2] = [
        ("without control", |f| f.without, RGBColor(0xd0, 0x5a, 0x1e)),
        ("with a deadline", |f| f.with, RGBColor(0x1f, 0x6f, 0xb4)),
    ];
    let mut times = chart_in(&areas[0], "time of a frame, ms", frames.len(), ROOM * most)?;
    for (name, values, color) in lines {
        times
            .draw_series(LineSeries::new(number(values), color))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], color));
    }
    let ends = [(0.0, deadline), (frames.len() as f64, deadline)];
    times
        .draw_series(LineSeries::new(ends, BLACK))?
        .label("deadline")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 20, y)], BLACK));
    let corner = SeriesLabelPosition::UpperRight;
    times
        .configure_series_labels()
        .position(corner.clone())
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK)
        .draw()?;
    // Frames that were not cut are drawn at the sensor's range.
    let top = if range_max.is_finite() { range_max } else { 50.0 };
    let mut metres = chart_in(&areas[1], "radius and complete_to, m", frames.len(), ROOM * top)?;
    let within = |value: f64| value.min(top);
    let lines: [Line; 2] = [
        ("radius", |f| f.radius, RGBColor(0x80, 0x80, 0x80)),
        ("complete_to", |f| f.complete_to, RGBColor(0x1f, 0x6f, 0xb4)),
    ];
    for (name, values, color) in lines {
        let points = number(values).map(move |(x, y)| (x, within(y)));
        metres
            .draw_series(LineSeries::new(points, color))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], color));
    }
    metres.configure_series_labels().position(corner).background_style(WHITE.mix(0.8)).border_style(BLACK).draw()?;
    let mut strides = chart_in(&areas[2], "stride (0: refused)", frames.len(), 9.0)?;
    let stride: fn(&Frame) -> f64 = |f| if f.refused { 0.0 } else { f64::from(f.stride) };
    strides.draw_series(LineSeries::new(number(stride), RGBColor(0x1f, 0x6f, 0xb4)))?;
    root.present()?;
    Ok(())
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Plane<'a, 'b> = ChartContext<
    'a,
    SVGBackend<'b>,
    Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>,
>;

/// The axes of a chart over the frames.
fn chart_in<'a, 'b>(area: &'a Area<'b>, name: &str, frames: usize, top: f64) -> Outcome<Plane<'a, 'b>> {
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .x_label_area_size(30)
        .y_label_area_size(55)
        .build_cartesian_2d(0.0..frames as f64, 0.0..top)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_label_formatter(&|x| format!("{x:.0}"))
        .y_label_formatter(&|y| format!("{y}"))
        .x_desc("frame")
        .y_desc(name)
        .draw()?;
    Ok(chart)
}
