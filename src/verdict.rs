//! Verdicts: what a measured image says of the prediction, pixel by pixel.
//!
//! ```
//! use presight::measured::{Frame, Measurement, RangeNoise};
//! use presight::verdict::{ExpectedImage, Surfaces, Uncertainty, Verdict, judge};
//! use presight::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
//! use presight::{Options, Pose, Predictor, World};
//! use std::sync::Arc;
//!
//! // A wall 2 m ahead, 4 m wide, and a scanner that sees a box 1 m before it.
//! let mut environment = Environment::new();
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

#[doc(inline)]
pub use presight_localize::verdict::{ExpectedImage, Surfaces, Uncertainty, Verdict, Verdicts, judge};
