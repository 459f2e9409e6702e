//! `visualization_msgs/msg/MarkerArray`.

use super::{CompressedImage, Header, Message};
use crate::cdr::{Cursor, Field, Sink, fields};
use presight_model::error::Result;
use presight_model::geometry::Pose;

/// The shape of a marker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MarkerKind {
    /// From the first of two points to the second.
    Arrow = 0,
    /// A box with the sides of the scale.
    Cube = 1,
    /// Lines between points 0 and 1, 2 and 3, ...; x of the scale is their width.
    LineList = 5,
    /// A box at each point, with the sides of the scale.
    CubeList = 6,
    /// Text that turns to the viewer; z of the scale is the height of a capital letter.
    Text = 9,
    /// Triangles of points 0 1 2, 3 4 5, ...
    TriangleList = 11,
}

/// A shape in the scene of a viewer. Fields of the message that presight does not use are empty.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneMarker {
    /// Stamp, and the frame of the marker.
    #[doc(hidden)]
    pub header: Header,
    /// With `id` the name of the marker: a later one of the same name replaces it.
    pub namespace: String,
    /// The number in its namespace.
    pub id: i32,
    /// The shape; `None` deletes all markers of the topic.
    pub kind: Option<MarkerKind>,
    /// frame_from_marker, metres.
    pub pose: Pose,
    /// Size along x, y and z, metres; its meaning depends on the shape.
    pub scale: [f64; 3],
    /// Red, green, blue and opacity, from 0 to 1.
    pub color: [f32; 4],
    /// Points of lines and triangles, metres, in the axes of the marker.
    pub points: Vec<[f64; 3]>,
    /// The text of [`MarkerKind::Text`].
    pub text: String,
}

impl SceneMarker {
    /// Width of lines, metres: visible from across a hall, and narrower than what scanners resolve there.
    pub const LINE_M: f64 = 0.02;

    /// Lines between points 0 and 1, 2 and 3, ..., metres in the axes of the marker.
    pub fn lines(namespace: impl Into<String>, color: [f32; 4], points: impl IntoIterator<Item = [f64; 3]>) -> Self {
        let mut marker = Self::new(MarkerKind::LineList, namespace, color);
        (marker.scale, marker.points) = ([Self::LINE_M; 3], points.into_iter().collect());
        marker
    }

    /// A shape without points at the origin of its frame, with a scale of 1 m. The sender sets stamp, frame and id.
    pub fn new(kind: MarkerKind, namespace: impl Into<String>, color: [f32; 4]) -> Self {
        Self {
            header: Header { stamp_ns: 0, frame_id: String::new() },
            namespace: namespace.into(),
            id: 0,
            kind: Some(kind),
            pose: Pose::IDENTITY,
            scale: [1.0; 3],
            color,
            points: Vec::new(),
            text: String::new(),
        }
    }
}

/// Markers of one publication.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerArray {
    /// The markers.
    pub markers: Vec<SceneMarker>,
}

impl Message<'_> for MarkerArray {
    const TYPE: &'static str = "visualization_msgs/msg/MarkerArray";
}

fields!(MarkerArray { markers });

/// `SceneMarker.action` that deletes all markers.
const DELETE_ALL: i32 = 3;

impl<'a> Field<'a> for SceneMarker {
    fn read(cursor: &mut Cursor<'a>) -> Result<Self> {
        let (header, namespace, id) = (Field::read(cursor)?, Field::read(cursor)?, Field::read(cursor)?);
        let (kind, action) = (i32::read(cursor)?, i32::read(cursor)?);
        let kinds = [
            MarkerKind::Arrow,
            MarkerKind::Cube,
            MarkerKind::LineList,
            MarkerKind::CubeList,
            MarkerKind::Text,
            MarkerKind::TriangleList,
        ];
        let pose = Option::<Pose>::read(cursor)?.unwrap_or(Pose::IDENTITY);
        let (scale, color) = (Field::read(cursor)?, Field::read(cursor)?);
        <[u32; 2]>::read(cursor)?; // lifetime
        bool::read(cursor)?; // frame_locked
        let points = Field::read(cursor)?;
        Vec::<[f32; 4]>::read(cursor)?; // colors
        String::read(cursor)?; // texture_resource
        CompressedImage::read(cursor)?; // texture
        Vec::<[f32; 2]>::read(cursor)?; // uv_coordinates
        let text = Field::read(cursor)?;
        String::read(cursor)?; // mesh_resource
        String::read(cursor)?; // mesh_file.filename
        <&[u8]>::read(cursor)?; // mesh_file.data
        bool::read(cursor)?; // mesh_use_embedded_materials
        let kind = kinds.into_iter().find(|known| *known as i32 == kind).filter(|_| action != DELETE_ALL);
        Ok(Self { header, namespace, id, kind, pose, scale, color, points, text })
    }

    fn write(&self, sink: &mut Sink) {
        self.header.write(sink);
        self.namespace.write(sink);
        self.id.write(sink);
        self.kind.map_or(0, |kind| kind as i32).write(sink);
        self.kind.map_or(DELETE_ALL, |_| 0).write(sink);
        Some(self.pose).write(sink);
        self.scale.write(sink);
        self.color.write(sink);
        [0u32; 2].write(sink); // lifetime: for ever
        false.write(sink);
        self.points.write(sink);
        Vec::<[f32; 4]>::new().write(sink);
        String::new().write(sink);
        let header = Header { stamp_ns: 0, frame_id: String::new() };
        CompressedImage { header, format: String::new(), data: &[] }.write(sink);
        Vec::<[f32; 2]>::new().write(sink);
        self.text.write(sink);
        String::new().write(sink);
        String::new().write(sink);
        (&[] as &[u8]).write(sink);
        false.write(sink);
    }
}
