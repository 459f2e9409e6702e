//! The keys of a layer file for serde. Whether they fit together is checked later.

use presight_model::geometry::{InObject, PoseCovariance};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error as _, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::value::RawValue;
use std::fmt;
use std::marker::PhantomData;

/// A whole file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LayerFields<'a> {
    #[serde(rename = "$schema")]
    _schema: Option<String>,
    #[serde(deserialize_with = "whole")]
    pub format: u32,
    pub class: String,
    pub tolerance: Option<f64>,
    #[serde(default)]
    pub pose_covariances: PoseCovariances,
    /// Raw text, because each feature is parsed separately.
    #[serde(borrow)]
    pub features: Vec<&'a RawValue>,
}

/// A feature of any kind, or the removal of one, as the keys of a layer file. Its checks:
/// [`from_fields`](super::from_fields).
#[derive(Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FeatureFields {
    /// The feature's id in its layer.
    #[serde(deserialize_with = "whole")]
    pub id: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) kind: Option<Kind>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) name: Option<String>,
    /// The object in whose frame the feature is; `None` in the world frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) points: Option<Vec<[f64; 3]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) anchor: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) crease_deg: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) sigma: Option<Sigma>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) covariance: Option<[f64; 9]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) covariances: Option<[[f64; 9]; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) cross_covariance: Option<[f64; 9]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) existence: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) confirmed: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rate: Option<f64>,
    #[serde(default, deserialize_with = "keyed", skip_serializing_if = "Option::is_none")]
    pub(crate) properties: Option<PropertyFields>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) surface: Option<Surface>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) remove: Option<bool>,
}

/// State of the polygons that a feature was placed on.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Surface {
    /// They have since been moved or deleted.
    Lost,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Kind {
    Point,
    Segment,
    Patch,
    Reflector,
    Fiducial,
    Contour,
}

#[derive(Default, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PropertyFields {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub strength: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contrast: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub family: Option<String>,
    #[serde(default, deserialize_with = "some_whole", skip_serializing_if = "Option::is_none")]
    pub code: Option<u32>,
}

/// A JSON object. Serde alone would also accept a list of the values in order, which the schema does not allow.
pub(super) struct Keyed<T>(pub T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Keyed<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Keys<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Keys<T> {
            type Value = Keyed<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object, {\"key\": value, ..}")
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Keyed<T>, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map)).map(Keyed)
            }
        }
        deserializer.deserialize_map(Keys(PhantomData))
    }
}

fn keyed<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
    Option::<Keyed<T>>::deserialize(deserializer).map(|given| given.map(|Keyed(fields)| fields))
}

/// A whole number. JSON and the schema also allow 1.0 for 1.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "f64")]
pub(super) struct Whole(pub u32);

impl TryFrom<f64> for Whole {
    type Error = String;

    fn try_from(v: f64) -> Result<Self, String> {
        let fits = (0.0..=f64::from(u32::MAX)).contains(&v) && v.fract() == 0.0;
        fits.then_some(Self(v as u32)).ok_or_else(|| format!("{v} is not a whole number from 0 to 4294967295"))
    }
}

fn whole<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    Whole::deserialize(deserializer).map(|Whole(n)| n)
}

fn some_whole<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u32>, D::Error> {
    Option::<Whole>::deserialize(deserializer).map(|given| given.map(|Whole(n)| n))
}

/// One standard deviation for all axes, or three, metres. An untagged enum would lose the line of errors.
#[derive(Clone, Copy, Serialize)]
#[serde(transparent)]
pub(crate) struct Sigma(pub [f64; 3]);

impl<'de> Deserialize<'de> for Sigma {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct OneOrThree;
        impl<'de> Visitor<'de> for OneOrThree {
            type Value = Sigma;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a standard deviation in metres, or three")
            }

            fn visit_f64<E>(self, v: f64) -> Result<Sigma, E> {
                Ok(Sigma([v; 3]))
            }

            fn visit_u64<E>(self, v: u64) -> Result<Sigma, E> {
                Ok(Sigma([v as f64; 3]))
            }

            fn visit_i64<E>(self, v: i64) -> Result<Sigma, E> {
                Ok(Sigma([v as f64; 3]))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Sigma, A::Error> {
                Deserialize::deserialize(serde::de::value::SeqAccessDeserializer::new(seq)).map(Sigma)
            }
        }
        deserializer.deserialize_any(OneOrThree)
    }
}

/// Object paths with 36 numbers each, in the order of the file.
#[derive(Default)]
pub(super) struct PoseCovariances(pub Vec<(String, PoseCovariance<InObject>)>);

impl<'de> Deserialize<'de> for PoseCovariances {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ByPath;
        impl<'de> Visitor<'de> for ByPath {
            type Value = PoseCovariances;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("36 numbers for each object path")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<PoseCovariances, A::Error> {
                let mut found: Vec<(String, PoseCovariance<InObject>)> = Vec::new();
                let mut seen = std::collections::HashSet::new();
                while let Some((path, numbers)) = map.next_entry::<String, Vec<f64>>()? {
                    let covariance = PoseCovariance::unchecked_row_major(&numbers)
                        .map_err(|_| format!("{} numbers for object {path:?}, but 36 are needed", numbers.len()))
                        .map_err(A::Error::custom)?;
                    if !seen.insert(path.clone()) {
                        return Err(A::Error::custom(format!("object {path:?} is given twice")));
                    }
                    found.push((path, covariance));
                }
                Ok(PoseCovariances(found))
            }
        }
        deserializer.deserialize_map(ByPath)
    }
}
