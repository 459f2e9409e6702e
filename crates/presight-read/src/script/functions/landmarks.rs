//! Features on shapes. They move with their shape and are placed with it.

use crate::script::call::{Call, Function, NamedValue, Options};
use crate::script::shape::Mark;
use glam::{DMat3, DVec3};
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::error::{Error, Result};
use rhai::Dynamic;

/// Option keys of every feature.
const KEYS: [&str; 9] = ["id", "name", "sigma", "existence", "confirmed", "rate", "strength", "contrast", "normal"];

/// Adds a feature to the shape. Argument number `options` holds its options, if given.
fn marked(c: &Call<'_, '_>, options: usize, shape_of: impl FnOnce(DMat3) -> Result<FeatureShape>) -> Result<Dynamic> {
    let options = if c.has(options) { c.options(options, &KEYS)? } else { Options::none() };
    let classes = c.arg(1).texts()?;
    let default = Existence::default();
    let mark = Mark {
        classes,
        id: options.get("id").map(|g| g.count()).transpose()?,
        name: options.get("name").map(|g| g.text()).transpose()?,
        shape: shape_of(covariance(&options)?)?,
        existence: Existence {
            p0: options.number("existence")?.unwrap_or(default.p0),
            confirmed: options.number("confirmed")?.unwrap_or(default.confirmed),
            rate: options.number("rate")?.unwrap_or(default.rate),
        },
        properties: Properties {
            strength: options.number("strength")?,
            contrast: options.number("contrast")?,
            normal: options.get("normal").map(|g| unit(&g)).transpose()?,
        },
    };
    check(&mark)?;
    c.shape(0)?.marked(mark, &c.studio.budget).map(Dynamic::from)
}

/// Checks the feature now rather than when the layer is made, so that errors name this call.
fn check(mark: &Mark) -> Result<()> {
    let feature = Feature {
        id: mark.id.unwrap_or(1),
        name: mark.name.clone(),
        object: None,
        shape: mark.shape.clone(),
        existence: mark.existence,
        properties: mark.properties.clone(),
    };
    feature.check(presight_model::environment::DEFAULT_TOLERANCE)?;
    feature.check_dictionary()
}

/// The covariance from `sigma`: standard deviations along x, y and z, or one for all, metres.
fn covariance(options: &Options) -> Result<DMat3> {
    let Some(given) = options.get("sigma") else { return Ok(DMat3::ZERO) };
    let sigma = given.number().map(DVec3::splat).or_else(|_| given.point())?;
    if sigma.min_element() < 0.0 {
        return Err(Error::invalid(format!("sigma is {sigma}"), "give metres, 0 or more"));
    }
    Ok(DMat3::from_diagonal(sigma * sigma))
}

fn unit(given: &NamedValue<'_>) -> Result<DVec3> {
    let n = given.point()?;
    n.try_normalize().ok_or_else(|| Error::invalid("the normal has no length", "give a direction"))
}

fn point(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let at = c.arg(2).point()?;
    marked(c, 3, |covariance| Ok(FeatureShape::Point { at, covariance }))
}

fn reflector(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let at = c.arg(2).point()?;
    marked(c, 3, |covariance| Ok(FeatureShape::Reflector { at, covariance }))
}

fn segment(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let ends = [c.arg(2).point()?, c.arg(3).point()?];
    marked(c, 4, |covariance| {
        // Only the position of the segment as a whole is uncertain.
        Ok(FeatureShape::Segment { ends, covariances: [covariance; 2], cross: covariance })
    })
}

fn patch(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let corners = c.arg(2).list("points [[x, y, z], ..]", |g| g.point())?;
    marked(c, 3, |covariance| Ok(FeatureShape::Patch { corners, covariance }))
}

fn fiducial(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let (pose, half) = (c.arg(2).pose()?, 0.5 * c.number(3)?);
    if !(half > 0.0) {
        return Err(Error::invalid(format!("side is {}", 2.0 * half), "give metres above 0"));
    }
    let (family, code) = (c.arg(4).text()?, c.count(5)?);
    // Looking along -x at the marker, +y is to the right.
    let corners = [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
        .map(|(y, z)| pose.transform_point(DVec3::new(0.0, y * half, z * half)));
    marked(c, 6, |covariance| Ok(FeatureShape::Fiducial { corners, covariance, family, code }))
}

pub(super) const FUNCTIONS: &[Function] = &[
    Function {
        signature: "point(shape, class, at) -> shape",
        does: "adds a point feature for a sensor class or an array of classes; it moves with the shape, and every \
               placed object has it",
        run: point,
    },
    Function {
        signature: "point(shape, class, at, options) -> shape",
        does: "with options, the same for all features: `id`, `name`, `sigma` (metres, or [x, y, z]), `existence`, \
               `confirmed` (UTC seconds), `rate` (1 / s), `strength`, `contrast`, `normal`",
        run: point,
    },
    Function { signature: "segment(shape, class, from, to) -> shape", does: "adds a straight edge", run: segment },
    Function { signature: "segment(shape, class, from, to, options) -> shape", does: "with options", run: segment },
    Function { signature: "patch(shape, class, corners) -> shape", does: "adds a plane patch", run: patch },
    Function { signature: "patch(shape, class, corners, options) -> shape", does: "with options", run: patch },
    Function { signature: "reflector(shape, class, at) -> shape", does: "adds a retroreflector", run: reflector },
    Function { signature: "reflector(shape, class, at, options) -> shape", does: "with options", run: reflector },
    Function {
        signature: "fiducial(shape, class, pose, side, family, code) -> shape",
        does: "adds a square marker centred on the pose's origin; it faces +x, its top is +z; `family` is OpenCV's name \
               of the dictionary",
        run: fiducial,
    },
    Function {
        signature: "fiducial(shape, class, pose, side, family, code, options) -> shape",
        does: "with options",
        run: fiducial,
    },
];
