//! Nearest obstacle by direction, and along the robot's planned path.
//!
//! Every surface hit by a beam counts, including the floor if beams point down. The corridor's lower height limit
//! excludes the floor there. Surfaces that no beam hits are not reported.

use super::pixels::Pixels;
use super::{Corridor, CorridorFrame, View};
use glam::DVec3;
use presight_model::error::Result;
use presight_render::deadline::Degradation;
use serde::Serialize;

/// The closest obstacles.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Nearest {
    /// By column of the sensor.
    pub directions: Directions,
    /// Nearest in all directions; `None` if no beam hits anything.
    pub nearest: Option<NearestPoint>,
    /// Inside the corridor, if one is given.
    pub corridor: Option<InCorridor>,
    /// Completeness limit, metres: if beams were given up for a deadline, nothing farther away than this is reported.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub complete_to: Option<f64>,
}

/// The closest obstacle of each column, over all its rows.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Directions {
    /// Azimuth of the column about the sensor's z axis, from its x axis, radians, -pi..=pi.
    pub azimuth: Vec<f64>,
    /// Metres along the beam. Infinite (null in files) without a hit. NaN (null) if beams were given up and there is no
    /// hit up to [`Nearest::complete_to`].
    pub range: Vec<f64>,
    /// The object hit; 0 for none.
    pub object_id: Vec<u32>,
}

/// A point of an obstacle.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NearestPoint {
    /// Position, metres.
    pub point_robot: [f64; 3],
    /// Metres from the sensor, along the beam.
    pub range: f64,
    /// Column and row of the beam.
    pub pixel: [u32; 2],
    /// The polygon as numbered in `polygon_id`; 0 if unknown.
    pub polygon: u32,
    /// Full path of the object; empty if unknown.
    pub object: String,
}

/// Obstacles in the corridor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InCorridor {
    /// Length of the corridor's line, metres.
    pub length: f64,
    /// Metres along that line to the first visible obstacle; `None` if there is none.
    pub arc_length: Option<f64>,
    /// Its point there; the nearest to the sensor if there are several.
    pub first: Option<NearestPoint>,
    /// Number of beams that hit something inside.
    pub beams: usize,
}

impl Nearest {
    pub(super) fn summary(&self) -> String {
        let nearest = match &self.nearest {
            Some(p) => format!("nearest at {:.3} m: {:?}", p.range, p.object),
            None => match self.complete_to {
                Some(complete_to) => format!("none up to {complete_to:.3} m"),
                None => "nothing is seen".into(),
            },
        };
        let Some(corridor) = &self.corridor else { return nearest };
        match (corridor.arc_length, &corridor.first) {
            (Some(s), Some(p)) => {
                format!("{nearest}; corridor free for {s:.3} of {:.3} m: {:?}", corridor.length, p.object)
            }
            _ if self.complete_to.is_some() => format!("{nearest}; none of it in the corridor"),
            _ => format!("{nearest}; nothing is seen in the {:.3} m of the corridor", corridor.length),
        }
    }
}

/// A hit with its sort key.
struct Hit {
    key: f64,
    range: f64,
    pixel: [u32; 2],
    p_in_sensor: DVec3,
    object: Option<u32>,
}

/// Keeps the hit with the smaller key, then the smaller range.
fn keep(best: &mut Option<Hit>, hit: Hit) {
    if best.as_ref().is_none_or(|b| (hit.key, hit.range) < (b.key, b.range)) {
        *best = Some(hit);
    }
}

pub(super) fn reduce(view: &View<'_>, corridor: Option<&Corridor>) -> Result<Nearest> {
    let mut pixels = Pixels::new(view)?;
    let (width, height) = (pixels.sensor.width(), pixels.sensor.height());
    let mut directions = Directions::default();
    let (mut nearest, mut first, mut beams) = (None, None, 0);
    let corridor_from_sensor = corridor.map(|c| match c.frame() {
        CorridorFrame::Robot => view.sensor.spec().mount,
        CorridorFrame::World => view.pose.world_from_sensor(),
    });
    let complete_to = view.given_up.map(Degradation::complete_everywhere_to).filter(|to| to.is_finite());
    for column in 0..width {
        let azimuth = (0..height).find_map(|row| pixels.ray(column, row)).map_or(f64::NAN, |ray| ray.y.atan2(ray.x));
        let (mut least, mut object_id) = (f64::INFINITY, 0);
        let is_open = |row: u32| pixels.range[pixels.at(column, row)].is_nan() && pixels.ray(column, row).is_some();
        let is_partial = complete_to.is_some() && (0..height).any(is_open);
        for row in 0..height {
            let Some((p_in_sensor, object)) = pixels.measured(column, row) else { continue };
            let range = p_in_sensor.length();
            // A beam that was given up might have hit something nearer.
            let is_unsure = complete_to.is_some_and(|complete_to| range > complete_to);
            if is_unsure && is_partial {
                continue;
            }
            let hit = |key| Hit { key, range, pixel: [column, row], p_in_sensor, object };
            if range < least {
                (least, object_id) = (range, object.map_or(0, |o| o + 1));
            }
            if is_unsure {
                continue;
            }
            keep(&mut nearest, hit(range));
            if let Some(s) = corridor
                .zip(corridor_from_sensor)
                .and_then(|(c, pose)| c.arc_length_at(pose.transform_point(p_in_sensor).to_array()))
            {
                beams += 1;
                keep(&mut first, hit(s));
            }
        }
        directions.azimuth.push(azimuth);
        directions.range.push(if is_partial && least == f64::INFINITY { f64::NAN } else { least });
        directions.object_id.push(object_id);
    }
    let point = |hit: &Hit| NearestPoint {
        point_robot: pixels.in_robot(hit.p_in_sensor),
        range: hit.range,
        pixel: hit.pixel,
        polygon: pixels.polygon_id.get(pixels.at(hit.pixel[0], hit.pixel[1])).copied().unwrap_or(0),
        object: hit.object.map_or(String::new(), |o| pixels.name(o)),
    };
    let corridor = corridor.map(|c| InCorridor {
        length: c.length(),
        arc_length: first.as_ref().map(|hit: &Hit| hit.key),
        first: first.as_ref().map(point),
        beams,
    });
    Ok(Nearest { directions, nearest: nearest.as_ref().map(point), corridor, complete_to })
}
