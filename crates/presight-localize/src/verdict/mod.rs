//! Verdicts: what a measured image says of the prediction, pixel by pixel.
//!
//! [`ExpectedImage`] is a prediction with the exact plane of each pixel's polygon. [`judge`] compares a [`crate::frame::Frame`] with
//! it: each pixel is confirmed, nearer, farther and so on ([`Verdict`]), tight by what is known of the noise and of the pose.
//!
//! # Examples
//! ```
//! use presight::measured::{Frame, RangeNoise, Measurement};
//! use presight::verdict::{ExpectedImage, Surfaces, Uncertainty, Verdict, judge};
//! use presight::{Material, Mesh, NewObject, Options, Polygon, PolygonOrder, Pose, Predictor, World};
//! use std::sync::Arc;
//!
//! // A wall 2 m ahead, 4 m wide, and a scanner that sees a box 1 m before it.
//! let mut environment = presight::Environment::new();
//! let paint = environment.add_material(Material::named("paint"))?;
//! let corners = [[2.0, -2.0, -1.0], [2.0, -2.0, 1.0], [2.0, 2.0, 1.0], [2.0, 2.0, -1.0]].map(glam::Vec3::from);
//! let mesh = Mesh::new("wall", corners.to_vec(), vec![Polygon::new(vec![0, 1, 2, 3], paint)], PolygonOrder::Given)?;
//! environment.insert(NewObject::new("wall", Pose::IDENTITY, Arc::new(mesh)))?;
//! let world = World::new(environment);
//! let scanner = presight::preset("laser-scanner")?; // 180 looks ahead
//!
//! let mut predictor = Predictor::new(Options::default())?;
//! let expected = ExpectedImage::predict(&mut predictor, &world, &mut Surfaces::default(), &scanner, &Pose::IDENTITY)?;
//! let mut ranges: Vec<f32> = expected.pixels().iter().map(|p| p.range).collect();
//! ranges[180] = 1.0;
//! ranges[170] += 0.5;
//! let frame = Frame::new(0.0, scanner.clone(), Measurement::Range(ranges))?;
//! let known = Uncertainty { noise: RangeNoise::of(&scanner), pose: [[0.0; 6]; 6], polygons: 0.001 };
//! let verdicts = judge(&frame, &expected, &Pose::IDENTITY, &known)?;
//! assert_eq!(verdicts.pixels[180], Verdict::Nearer);
//! assert_eq!(verdicts.pixels[170], Verdict::Farther);
//! assert_eq!(verdicts.pixels[175], Verdict::Confirmed);
//! assert_eq!(verdicts.pixels[0], Verdict::Beyond);
//! # Ok::<(), presight::Error>(())
//! ```

mod expected;
mod judge;
mod strided;
mod surfaces;

pub use expected::body_from_image;
pub use expected::{ExpectedImage, ExpectedPixel};
pub use judge::{Uncertainty, Verdict, Verdicts, judge};
pub use strided::LANES;
pub use surfaces::{ObjectError, Surface, Surfaces};
