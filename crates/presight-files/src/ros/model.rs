//! A model as markers.

use super::MessageOrigin;
use presight_model::environment::Environment;
use presight_model::error::{Error, ErrorKind, Result};
use presight_ros::Record;
use presight_ros::message::{Header, MarkerArray, MarkerKind, SceneMarker};

/// The largest model that becomes one message, triangles: at 72 bytes each it takes 151 MB, half of what readers of
/// bags, presight among them, take for the largest message.
const MAX_TRIANGLES: usize = 1 << 21;

/// The model as triangles on `/presight/model`, one marker for each object, in the colour of its first polygon. It replaces
/// an earlier model.
///
/// # Errors
/// [`ErrorKind::Unsupported`] for a model of more than 2,097,152 triangles.
pub fn model(environment: &Environment, map: &str, stamp_ns: i64) -> Result<Record> {
    let objects = environment.objects();
    let mut triangles = 0;
    let mut markers = vec![all_before(&Header { stamp_ns, frame_id: map.to_owned() })];
    for (id, object) in objects.iter().enumerate() {
        let polygons = object.mesh.polygon_count() as u32;
        let mut points = Vec::new();
        for polygon in 0..polygons {
            let corners = object.polygon_in_world(polygon);
            triangles += corners.len().saturating_sub(2);
            if triangles > MAX_TRIANGLES {
                let what = format!("the model has more than {MAX_TRIANGLES} triangles, too many for one message");
                return Err(Error::new(ErrorKind::Unsupported, what, "show the file of the model in the viewer"));
            }
            // Polygons are convex.
            points.extend(
                corners.windows(2).skip(1).flat_map(|edge| [corners[0], edge[0], edge[1]]).map(|p| p.to_array()),
            );
        }
        if points.is_empty() {
            continue;
        }
        let material = object.mesh.materials().first().map_or(0, |material| usize::from(*material));
        let color = environment.materials().get(material).map_or([0.8; 3], |material| material.color);
        let [r, g, b] = color.map(srgb);
        let mut marker = SceneMarker::new(MarkerKind::TriangleList, &object.name, [r, g, b, 1.0]);
        marker.header = Header { stamp_ns, frame_id: map.to_owned() };
        (marker.id, marker.points) = (id as i32, points);
        markers.push(marker);
    }
    Ok(Record::of("/presight/model", stamp_ns, &MarkerArray { markers }))
}

/// Deletes the markers that a topic had.
fn all_before(header: &Header) -> SceneMarker {
    SceneMarker { kind: None, header: header.clone(), ..SceneMarker::new(MarkerKind::Cube, "", [0.0; 4]) }
}

impl MessageOrigin {
    /// Markers in a frame, which replace the markers that the topic had.
    pub fn markers(&self, topic: &str, frame: &str, markers: impl IntoIterator<Item = SceneMarker>) -> Record {
        let mut all = vec![all_before(&self.header(frame))];
        all.extend(markers);
        for (id, marker) in all.iter_mut().enumerate() {
            (marker.header, marker.id) = (self.header(frame), id as i32);
        }
        Record::of(topic, self.stamp_ns, &MarkerArray { markers: all })
    }
}

/// The sRGB value of a linear one (IEC 61966-2-1).
fn srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}
