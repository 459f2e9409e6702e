//! Serde representations of poses, sensors and requests, as in files and on the command line.
//!
//! | type | form |
//! |---|---|
//! | `Pose` | `[x, y, z, qx, qy, qz, qw]`; `[x, y, z, roll_deg, pitch_deg, yaw_deg]` is also accepted |
//! | [`SensorSpec`], [`Sensor`] | the keys of a sensor file ([`super::sensor_toml`]); an infinite `range_max` is omitted, a missing ray is three nulls |
//! | [`Outputs`] | a list of names |
//! | [`IdScheme`] | `"model"` or `"source"` |
//! | [`Request`] | `outputs`, `ids`, `features` (`time`, `step`, `visibility`), `regions` (`pose_covariance`: 36 numbers, `objects`, `confidence`, `method`) and `deadline_ms`; each is optional |
//!
//! [`super::prediction_json`] describes predicted features.

use super::sensor_toml;
use presight_features::{BoxMethod, BoxOptions, FeatureOptions, FeatureSource, Hidden, STEP, Visibility};
use presight_model::geometry::PoseCovariance;
use presight_model::sensor::{Sensor, SensorSpec};
use presight_predict::request::Request;
use presight_render::plan::{IdScheme, Outputs};
use serde::de::Error as _;
use serde::ser::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;
use std::time::Duration;

/// A value in its form for serde: `Form(&value)` is written, `Form<T>` is read.
#[derive(Clone, Debug, PartialEq)]
pub struct Form<T>(pub T);

impl Serialize for Form<&SensorSpec> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut table: toml::Table = toml::from_str(&sensor_toml::to_string(self.0)).map_err(S::Error::custom)?;
        if self.0.range_max == f64::INFINITY {
            table.remove("range_max");
        }
        json_of(toml::Value::Table(table)).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Form<SensorSpec> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let table = toml_of(Value::deserialize(deserializer)?).map_err(D::Error::custom)?;
        let text = toml::to_string(&table).map_err(D::Error::custom)?;
        sensor_toml::parse(&text, "sensor", None).map(Self).map_err(D::Error::custom)
    }
}

impl Serialize for Form<&Sensor> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Form(self.0.spec()).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Form<Sensor> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let Form(spec) = Form::<SensorSpec>::deserialize(deserializer)?;
        Sensor::new(spec).map(Self).map_err(D::Error::custom)
    }
}

/// JSON has no NaN: it becomes null.
fn json_of(value: toml::Value) -> Value {
    match value {
        toml::Value::Float(x) => Value::from(x),
        toml::Value::Integer(n) => Value::from(n),
        toml::Value::Boolean(b) => Value::from(b),
        toml::Value::String(text) => Value::from(text),
        toml::Value::Datetime(date) => Value::from(date.to_string()),
        toml::Value::Array(all) => all.into_iter().map(json_of).collect(),
        toml::Value::Table(all) => Value::Object(all.into_iter().map(|(key, value)| (key, json_of(value))).collect()),
    }
}

/// In a list, null becomes NaN. A key whose value is null is dropped.
fn toml_of(value: Value) -> Result<toml::Value, String> {
    Ok(match value {
        Value::Null => toml::Value::Float(f64::NAN),
        Value::Bool(b) => b.into(),
        Value::Number(n) => match n.as_i64() {
            Some(n) => n.into(),
            None => n.as_f64().ok_or_else(|| format!("{n} is not a valid number"))?.into(),
        },
        Value::String(text) => text.into(),
        Value::Array(all) => toml::Value::Array(all.into_iter().map(toml_of).collect::<Result<_, _>>()?),
        Value::Object(all) => {
            let there = all.into_iter().filter(|(_, value)| !value.is_null());
            toml::Value::Table(there.map(|(key, value)| Ok((key, toml_of(value)?))).collect::<Result<_, String>>()?)
        }
    })
}

impl Serialize for Form<&Outputs> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(|output| output.name()))
    }
}

impl<'de> Deserialize<'de> for Form<Outputs> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let names = Vec::<String>::deserialize(deserializer)?;
        match names[..] {
            [] => Ok(Self(Outputs::of(&[]))),
            _ => names.join(",").parse().map(Self).map_err(D::Error::custom),
        }
    }
}

mod outputs_form {
    use super::{Deserialize, Deserializer, Form, Outputs, Serialize, Serializer};

    pub fn serialize<S: Serializer>(outputs: &Outputs, serializer: S) -> Result<S::Ok, S::Error> {
        Form(outputs).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Outputs, D::Error> {
        Form::deserialize(deserializer).map(|Form(outputs)| outputs)
    }
}

/// [`IdScheme`] by name.
#[derive(Serialize, Deserialize)]
#[serde(remote = "IdScheme", rename_all = "snake_case")]
enum IdsForm {
    Model,
    Source,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Hidden", rename_all = "snake_case")]
enum HiddenForm {
    Full,
    Reason,
    Count,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Visibility", rename_all = "snake_case")]
enum VisibilityForm {
    Image,
    Rays,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "BoxMethod", rename_all = "snake_case")]
enum MethodForm {
    AsNeeded,
    Linear,
    Set,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RequestForm {
    #[serde(with = "outputs_form", default)]
    outputs: Outputs,
    #[serde(with = "IdsForm", default)]
    ids: IdScheme,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    features: Option<FeaturesForm>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    regions: Option<RegionsForm>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    deadline_ms: Option<f64>,
}

const NANOSECONDS_IN_MS: f64 = 1e6;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FeaturesForm {
    #[serde(skip_serializing_if = "Option::is_none", default)]
    time: Option<f64>,
    #[serde(with = "HiddenForm", default)]
    hidden: Hidden,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    max_features: Option<usize>,
    #[serde(with = "VisibilityForm", default)]
    visibility: Visibility,
    #[serde(default = "default_step")]
    step: f64,
}

fn default_step() -> f64 {
    STEP
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RegionsForm {
    pose_covariance: Vec<f64>,
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    objects: Vec<(u32, Vec<f64>)>,
    confidence: f64,
    #[serde(with = "MethodForm", default)]
    method: BoxMethod,
}

fn flat<A>(covariance: &PoseCovariance<A>) -> Vec<f64> {
    covariance.as_rows().as_flattened().to_vec()
}

fn matrix<A, E: serde::de::Error>(numbers: &[f64]) -> Result<PoseCovariance<A>, E> {
    PoseCovariance::unchecked_row_major(numbers).map_err(E::custom)
}

impl Serialize for Form<&Request> {
    /// # Errors
    /// If the request holds placed features: they belong to one world in memory.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let request = self.0;
        let features = match &request.features {
            Some(FeatureOptions { source: FeatureSource::Placed(_), .. }) => {
                return Err(S::Error::custom("placed features belong to one world in memory and cannot be written"));
            }
            Some(f) => Some(FeaturesForm {
                time: f.time,
                hidden: f.hidden,
                max_features: f.max_features,
                visibility: f.visibility,
                step: f.step,
            }),
            None => None,
        };
        let regions = request.regions.as_ref().map(|r| RegionsForm {
            pose_covariance: flat(&r.sensor),
            objects: r.objects.iter().map(|(object, c)| (*object, flat(c))).collect(),
            confidence: r.confidence,
            method: r.method,
        });
        let deadline_ms = request.deadline.map(|deadline| deadline.as_nanos() as f64 / NANOSECONDS_IN_MS);
        RequestForm { outputs: request.outputs, ids: request.ids, features, regions, deadline_ms }.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Form<Request> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let form = RequestForm::deserialize(deserializer)?;
        let mut request = Request::of(form.outputs).with_ids(form.ids);
        if let Some(FeaturesForm { time, hidden, max_features, visibility, step }) = form.features {
            let options = FeatureOptions::default().with_hidden(hidden).with_visibility(visibility).with_step(step);
            let mut options = options;
            (options.time, options.max_features) = (time, max_features);
            request = request.with_features(options);
        }
        if let Some(regions) = form.regions {
            let sensor = matrix(&regions.pose_covariance)?;
            let object = |(object, c): &(u32, Vec<f64>)| Ok((*object, matrix(c)?));
            let objects = regions.objects.iter().map(object).collect::<Result<_, D::Error>>()?;
            let options = BoxOptions::default().with_sensor(sensor).with_objects(objects);
            request = request.with_regions(options.with_confidence(regions.confidence).with_method(regions.method));
        }
        if let Some(ms) = form.deadline_ms {
            let nanoseconds = (ms * NANOSECONDS_IN_MS).round();
            if !(0.0..u64::MAX as f64).contains(&nanoseconds) {
                return Err(D::Error::custom(format!("a deadline of {ms} ms; give 0 or more")));
            }
            request = request.with_deadline(Duration::from_nanos(nanoseconds as u64));
        }
        Ok(Self(request))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use presight_model::geometry::Pose;
    use presight_model::sensor::{Geometry, Noise, PRESETS, RayTable};
    use presight_render::plan::Output;
    use serde::de::DeserializeOwned;

    fn through_json<'a, T>(value: &'a T) -> T
    where
        Form<&'a T>: Serialize,
        Form<T>: DeserializeOwned,
    {
        serde_json::from_str::<Form<T>>(&serde_json::to_string(&Form(value)).unwrap()).unwrap().0
    }

    #[test]
    fn sensors_read_back_equal_infinities_and_missing_rays_included() {
        for preset in PRESETS {
            let sensor = crate::preset(preset.name).unwrap();
            assert_eq!(through_json(sensor.spec()), *sensor.spec(), "{}", preset.name);
            assert_eq!(through_json(&sensor).spec(), sensor.spec());
            let toml = toml::to_string(&Form(sensor.spec())).unwrap();
            assert_eq!(toml::from_str::<Form<SensorSpec>>(&toml).unwrap().0, *sensor.spec(), "{toml}");
        }
        let full = crate::preset("vlp-16").unwrap().spec().clone();
        let noise =
            Noise { range_sigma: 0.1, range_sigma_quadratic: 0.2, angle_sigma: 20f64.to_radians(), ..full.noise };
        let mount = Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.0 / 3.0), 0.0, 0.1, 3.0);
        let full = full
            .with_name("a \"b\"")
            .with_class("sonar")
            .with_limits(0.1, 1.0 / 3.0)
            .with_max_incidence(63f64.to_radians());
        let full = full.with_mount(mount).with_noise(Noise { pixel_sigma: 0.5, ..noise });
        assert_eq!(through_json(&full), full);
        let rays = RayTable::new(2, 1, vec![DVec3::X, DVec3::NAN]).unwrap();
        let spec = SensorSpec::new("two", "laser", Geometry::Rays(rays));
        assert_eq!(spec.range_max, f64::INFINITY);
        let text = serde_json::to_string(&Form(&spec)).unwrap();
        assert!(text.contains("[null,null,null]") && !text.contains("range_max"), "{text}");
        let back = through_json(&spec);
        assert_eq!(back.range_max, f64::INFINITY);
        let Geometry::Rays(table) = &back.geometry else { panic!("{back:?}") };
        assert!(table.directions()[0] == DVec3::X && table.directions()[1].is_nan());
        let unknown = r#"{"format": 1, "kind": "camera", "width": 2, "lens": 3}"#;
        assert!(serde_json::from_str::<Form<SensorSpec>>(unknown).is_err());
    }

    #[test]
    fn requests_read_back_equal_and_say_what_they_cannot_hold() {
        let full = Request::of(Outputs::of(&[Output::Range, Output::FeatureId]))
            .with_ids(IdScheme::Source)
            .with_features(
                FeatureOptions::default()
                    .with_time(1.79e9)
                    .with_hidden(Hidden::Reason)
                    .with_max_features(20)
                    .with_visibility(Visibility::Rays)
                    .with_step(0.1),
            )
            .with_deadline(Duration::from_nanos(16_666_667))
            .with_regions(
                BoxOptions::default()
                    .with_sensor_sigmas([0.1, 0.2, 0.0, 0.0, 0.0, 1.0 / 3.0])
                    .with_objects(vec![(3, PoseCovariance::from_rows([[0.25; 6]; 6]))])
                    .with_method(BoxMethod::Linear)
                    .with_confidence(0.9),
            );
        for request in [Request::default(), Request::of(Outputs::of(&[])), full.clone()] {
            assert_eq!(through_json(&request), request);
        }
        let json = serde_json::to_value(Form(&full)).unwrap();
        assert_eq!(json["outputs"], serde_json::json!(["range", "feature_id"]));
        assert_eq!((&json["ids"], &json["regions"]["method"]), (&"source".into(), &"linear".into()));
        assert_eq!(serde_json::from_str::<Form<Request>>("{}").unwrap().0, Request::default());
        assert!(serde_json::from_str::<Form<Request>>(r#"{"outputs": ["walls"]}"#).is_err());
        assert_eq!(json["deadline_ms"], 16.666667);
        for bad in [r#"{"deadlines": 1}"#, r#"{"deadline_ms": -1}"#, r#"{"deadline_ms": 1e300}"#] {
            assert!(serde_json::from_str::<Form<Request>>(bad).is_err(), "{bad}");
        }
        let placed = Request::default().with_features(FeatureOptions::default().with_placed(Vec::new()));
        assert!(serde_json::to_string(&Form(&placed)).unwrap_err().to_string().contains("placed"));
    }
}
