//! The files of a prediction.

use super::{Args, PointsFrameArg};
use crate::file_names::Paths;
use crate::layers::Layers;
use crate::print;
use presight::features::{BoxOptions, SeenFeature};
use presight::files;
use presight::predict::{PointCloud, PointsFrame};
use presight::virtual_sensors::{Settings, VirtualReading};
use presight::{Output, Prediction, Predictor, Result, Scene, Sensor, blake3_of};
use presight_pictures as png;

/// Data for output files that the prediction itself does not hold.
pub struct Shown {
    /// The options of the regions of interest.
    pub boxes: Option<BoxOptions>,
    /// Sides of partly visible patches, drawn in previews.
    pub sides: Vec<SeenFeature>,
    /// The virtual sensor's reading.
    pub reading: Option<VirtualReading>,
}

impl Shown {
    /// Computes the data from a prediction with these layers and settings.
    pub fn of(
        args: &Args,
        scene: &Scene,
        predictor: &mut Predictor,
        prediction: &Prediction,
        (layers, settings): (Option<&Layers>, &Settings),
    ) -> Result<Self> {
        let reading = args.virtual_sensor.read(scene, prediction, settings)?;
        let sides = match args.png.is_some() {
            true => predictor.predict_outlines(&scene.world, prediction)?,
            false => Vec::new(),
        };
        Ok(Self { boxes: layers.map(|layers| layers.boxes().clone()), sides, reading })
    }
}

/// Writes all files of a prediction except NumPy arrays.
pub fn write_files(
    args: &Args,
    paths: &Paths,
    scene: &Scene,
    prediction: &Prediction,
    attributes: Option<files::ExrAttributes>,
    shown: &Shown,
) -> Result<()> {
    let reading = shown.reading.as_ref();
    let (sensor, images) = (&prediction.sensor, &prediction.images);
    if let (Some(path), Some(attributes)) = (&paths.out, attributes) {
        let (given_up, raster) = (prediction.degradation().cloned(), prediction.stats.raster);
        let (pose, motion) = (Some(prediction.pose), prediction.request.motion.clone());
        let attributes = files::ExrAttributes { pose, motion, given_up, raster, ..attributes };
        files::write_exr(path, images, args.outputs, &attributes)?;
    }
    if let Some(path) = &paths.png {
        let overlay = prediction.features.as_ref().map(|features| png::Overlay {
            features,
            sides: &shown.sides,
            sensor,
            pose: prediction.pose,
            numbers: args.layers.numbers(),
        });
        let mark = reading.and_then(VirtualReading::mask);
        let given_up = prediction.not_predicted();
        let marks = png::Marks { overlay: overlay.as_ref(), mask: mark, given_up: &given_up };
        png::write_preview_with(path, images, sensor, args.png_of, &marks)?;
    }
    args.layers.write(scene, prediction, (args.asked(), shown), paths.features.as_deref())?;
    args.virtual_sensor.tell(reading, paths.mask.as_deref(), args.layers.writes_something())?;
    if let Some(path) = &paths.depth_png {
        print::notices(&png::write_depth(path, images, sensor)?);
    }
    if let Some(path) = &paths.points {
        let frame = match args.points_frame {
            PointsFrameArg::Sensor => PointsFrame::Sensor,
            PointsFrameArg::World => PointsFrame::World,
        };
        let motion = prediction.request.motion.as_ref();
        let cloud = PointCloud::of_scan(images, sensor, &prediction.pose, frame, motion, args.deskew);
        let cloud = cloud.map_err(|e| match args.deskew {
            Some(at) => e.at(format!("--deskew {at}")),
            None => e,
        })?;
        let cloud = cloud.only(args.outputs);
        let cloud = match args.normals() {
            true if !args.outputs.has(Output::Normal) => {
                cloud.with_normals(scene.world.environment(), args.scheme())?
            }
            _ => cloud,
        };
        print::notices(&match path.extension().is_some_and(|e| e.eq_ignore_ascii_case("pcd")) {
            true => files::write_pcd(path, &cloud)?,
            false => files::write_ply(path, &cloud)?,
        });
    }
    Ok(())
}

/// The attributes of an EXR file that do not depend on the pose.
pub fn attributes(args: &Args, scene: &Scene, sensor: &Sensor) -> Result<files::ExrAttributes> {
    let objects = scene.world.environment().objects();
    Ok(files::ExrAttributes {
        sensor: Some(files::sensor_to_toml(sensor.spec())),
        pose: None,
        motion: None,
        scene: Some(args.scene.display().to_string()),
        scene_blake3: Some(blake3_of(&args.scene)?),
        scene_content: Some(scene.world.environment().content_hash().to_string()),
        ids: Some(args.scheme()),
        given_up: None,
        raster: None,
        objects: (1..).zip(objects.iter().map(|o| o.name.clone())).collect(),
    })
}
