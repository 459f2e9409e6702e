//! Answers of a session, and the parts of requests that several of them share.

use glam::{DQuat, DVec3};
use presight::tools;
use presight::{Error, Pose, Result, SensorPose};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// The answer to a message.
#[derive(Debug)]
pub enum Answer {
    /// JSON.
    Json(String),
    /// Length of the JSON (u32, little-endian), JSON, zeros up to a multiple of 4, and the arrays that the JSON lists.
    Binary(Vec<u8>),
    /// The page knows an older version: the new state, as JSON.
    Behind(String),
    /// The request is wrong, or cannot be fulfilled.
    Wrong(Error),
    /// There is no such message.
    Unknown,
}

impl From<Result<Answer>> for Answer {
    fn from(done: Result<Answer>) -> Self {
        done.unwrap_or_else(Answer::Wrong)
    }
}

/// Reads the JSON of a request.
pub fn parse<T: DeserializeOwned>(body: &[u8]) -> Result<T> {
    serde_json::from_slice(body).map_err(|e| {
        let place = format!("line {}, column {}", e.line(), e.column());
        Error::usage(e.to_string(), "reload the page").at(place).caused_by(e)
    })
}

/// The sensor's pose of six or seven numbers: x, y, z and roll, pitch, yaw in degrees, or x, y, z and a quaternion.
pub fn pose_of(numbers: &[f64]) -> Result<SensorPose> {
    let remedy = "give x,y,z,roll_deg,pitch_deg,yaw_deg or x,y,z,qx,qy,qz,qw";
    if let Some(number) = numbers.iter().find(|x| !x.is_finite()) {
        return Err(Error::usage(format!("the pose has the number {number}"), remedy));
    }
    let at = |i: usize| DVec3::new(numbers[i], numbers[i + 1], numbers[i + 2]);
    let pose = match numbers.len() {
        6 => {
            let far = at(0).abs().max_element() > tools::MAX_COORDINATE;
            let [roll, pitch, yaw] = at(3).to_array().map(f64::to_radians);
            let pose = Pose::from_xyz_rpy(at(0), roll, pitch, yaw);
            if far { Err(Error::usage("the pose is too far away", remedy)) } else { pose.check().map(|()| pose) }
        }
        7 => Pose::new(at(0), DQuat::from_xyzw(numbers[3], numbers[4], numbers[5], numbers[6])),
        n => Err(Error::usage(format!("the pose has {n} numbers"), remedy)),
    };
    pose.map(SensorPose::new)
}

/// A pose as x, y, z, roll, pitch, yaw in metres and degrees. Adding 0 turns -0 into 0.
pub fn six_of(pose: &SensorPose) -> [f64; 6] {
    let pose = pose.world_from_sensor();
    let (roll, pitch, yaw) = pose.rpy();
    let [x, y, z] = pose.translation.to_array();
    [x, y, z, roll.to_degrees(), pitch.to_degrees(), yaw.to_degrees()].map(|c| c + 0.0)
}

/// A binary answer in the making.
pub struct Body {
    json: Value,
    arrays: Vec<Value>,
    bytes: Vec<u8>,
}

impl Body {
    /// Starts with the fields of a JSON object.
    pub fn new(json: Value) -> Self {
        Self { json, arrays: Vec::new(), bytes: Vec::new() }
    }

    /// Adds a field to the JSON.
    pub fn set(&mut self, key: &str, value: Value) {
        self.json[key] = value;
    }

    /// Adds an array of 32-bit numbers.
    pub fn array<const N: usize, T: Copy>(&mut self, name: &str, kind: &str, values: &[T], bytes: fn(T) -> [u8; N]) {
        self.arrays.push(json!({ "name": name, "kind": kind, "numbers": values.len() * N / 4 }));
        self.bytes.reserve(values.len() * N);
        values.iter().for_each(|value| self.bytes.extend_from_slice(&bytes(*value)));
    }

    /// The whole body.
    pub fn answer(mut self) -> Answer {
        self.json["arrays"] = Value::Array(self.arrays);
        let text = self.json.to_string();
        let mut whole = Vec::with_capacity(8 + text.len() + self.bytes.len());
        whole.extend_from_slice(&(text.len() as u32).to_le_bytes());
        whole.extend_from_slice(text.as_bytes());
        whole.resize(whole.len().next_multiple_of(4), 0);
        whole.extend_from_slice(&self.bytes);
        Answer::Binary(whole)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_of_six_and_seven_numbers_are_one() {
        let six = [1.0, -2.0, 3.0, 10.0, -20.0, 170.0];
        let pose = pose_of(&six).unwrap();
        let [x, y, z, w] = pose.world_from_sensor().rotation.to_array();
        let seven = pose_of(&[1.0, -2.0, 3.0, x, y, z, w]).unwrap();
        assert!((0..6).all(|i| (six_of(&seven)[i] - six[i]).abs() < 1e-12), "{:?}", six_of(&seven));
        let wrong: [&[f64]; 6] = [
            &[],
            &[0.0; 5],
            &[0.0, f64::NAN, 0.0, 0.0, 0.0, 0.0],
            &[0.0, 0.0, 0.0, f64::INFINITY, 0.0, 0.0],
            &[1e300, 0.0, 0.0, 0.0, 0.0, 0.0],
            &[0.0; 7],
        ];
        for numbers in wrong {
            assert!(!pose_of(numbers).unwrap_err().remedy().is_empty(), "{numbers:?}");
        }
    }

    /// The JSON ends at byte 4 + its length; arrays start at the next multiple of 4.
    #[test]
    fn bodies_hold_what_their_json_lists() {
        let mut body = Body::new(json!({ "a": 1 }));
        body.array("u", "u32", &[7u32, 8], u32::to_le_bytes);
        body.array("f", "f32", &[0.5f32], f32::to_le_bytes);
        let Answer::Binary(bytes) = body.answer() else { panic!() };
        let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
        let json: Value = serde_json::from_slice(&bytes[4..4 + length]).unwrap();
        assert_eq!(json["arrays"][0], json!({ "name": "u", "kind": "u32", "numbers": 2 }));
        let rest = &bytes[(4 + length).next_multiple_of(4)..];
        assert_eq!(rest, [[7, 0, 0, 0], [8, 0, 0, 0], 0.5f32.to_le_bytes()].as_flattened());
    }
}
