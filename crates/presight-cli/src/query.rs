//! `presight query`: questions to a model.

use super::pose::parse_pose;
use super::{CommandOutcome, open_scene, print};
use glam::DVec3;
use presight::environment::{Aabb, IndexKind};
use presight::files::{self, ImportOptions};
use presight::query::{
    FloorPath, PathOptions, Place, UncertainOptions, docks, find_path, objects_in, surface_distance,
    uncertain_features, uncertain_objects,
};
use presight::tools::read_settings;
use presight::virtual_sensors::CorridorFrame;
use presight::{Error, Pose, Result, RobotPose, World};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  presight query site.presight --box 2,1,0,4,3,2
  presight query site.presight --along way.json --pose 3,2,1,0,0,90 --json
  presight query site.presight --free 4.2,1.0,0.5
  presight query site.presight --path 0.7,0.8,0 4.4,3.6,0 --radius 0.25  # from x,y,z to x,y,z
  presight query scenes/docking.rhai --docks";

/// Ask a model for objects in a place, docks, uncertain features, the nearest surface, or a path
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
#[command(group(clap::ArgGroup::new("question").required(true)))]
pub struct Args {
    /// The model: a store, a .glb or .gltf file, or a .rhai script
    store: PathBuf,

    /// Objects with a surface in this box: least and greatest x, y, z, metres
    #[arg(long = "box", value_name = "X,Y,Z,X,Y,Z", group = "question", allow_hyphen_values = true)]
    in_box: Option<String>,

    /// Objects with a surface in this ball: middle and radius, metres
    #[arg(long, value_name = "X,Y,Z,R", group = "question", allow_hyphen_values = true)]
    sphere: Option<String>,

    /// Objects with a surface in this corridor, the nearest along it first
    #[arg(long, value_name = "FILE.json", group = "question")]
    along: Option<PathBuf>,

    /// Pose of the robot in whose frame the corridor of --along is
    #[arg(long, value_name = "POSE", requires = "along", allow_hyphen_values = true)]
    pose: Option<String>,

    /// Groups of two or more reflectors, with poses
    #[arg(long, group = "question")]
    docks: bool,

    /// Maximum distance between neighbouring reflectors of one dock, metres
    #[arg(long, value_name = "METRES", default_value_t = 1.0, requires = "docks")]
    apart: f64,

    /// Distance from this point to the nearest surface, metres
    #[arg(long, value_name = "X,Y,Z", group = "question", allow_hyphen_values = true)]
    free: Option<String>,

    /// Marks, and objects and features that probably do not exist any more, or were not confirmed --since
    #[arg(long, group = "question")]
    uncertain: bool,

    /// Probability of existence below which a feature is uncertain
    #[arg(long, value_name = "P", default_value_t = 0.5, requires = "uncertain")]
    below: f64,

    /// Time at which existence is evaluated, UTC seconds [default: the newest confirmation of each layer]
    #[arg(long, value_name = "TIME", requires = "uncertain")]
    time: Option<f64>,

    /// Also features that were not confirmed since this time, UTC seconds
    #[arg(long, value_name = "TIME", requires = "uncertain")]
    since: Option<f64>,

    /// A way on free floor from one point to another
    #[arg(long, value_names = ["FROM", "TO"], num_args = 2, group = "question", allow_hyphen_values = true)]
    path: Option<Vec<String>>,

    /// Radius of the robot, metres
    #[arg(long, value_name = "METRES", default_value_t = 0.4, requires = "path")]
    radius: f64,

    /// Maximum height of a step of the floor, metres; higher ones are obstacles and edges
    #[arg(long, value_name = "METRES", default_value_t = PathOptions::default().clearance, requires = "path")]
    step: f64,

    /// Height of the robot, metres
    #[arg(long, value_name = "METRES", default_value_t = PathOptions::default().height, requires = "path")]
    height: f64,

    /// Maximum slope of the floor, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = PathOptions::default().slope_deg, requires = "path")]
    slope: f64,

    /// Also around what `supervise` saw in its corridor in any frame
    #[arg(long, value_name = "RUN.jsonl", requires = "path")]
    blocked: Option<PathBuf>,

    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// Those of the scene, of the question, and of its files.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let question = Question::of(args)?;
    let scene = open_scene(&args.store, &ImportOptions::default(), IndexKind::default())?;
    print::far_outside(&scene, question.positions());
    let (value, lines) = question.answer(&scene.world)?;
    if args.json {
        print::data(&format!("{value:#}\n"))?
    } else {
        print::lines(lines)?
    }
    Ok(CommandOutcome::Done)
}

enum Question {
    Objects(Place),
    Docks(f64),
    Free(DVec3),
    Uncertain(UncertainOptions),
    Way(DVec3, DVec3, Vec<Aabb>, PathOptions),
}

/// Numbers of a flag, separated by commas.
fn numbers<const N: usize>(flag: &str, text: &str) -> Result<[f64; N]> {
    let found: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    let found = found.and_then(|all| <[f64; N]>::try_from(all).ok()).filter(|all| all.iter().all(|x| x.is_finite()));
    found.ok_or_else(|| Error::usage(format!("{flag} {text}"), format!("give {N} finite numbers, separated by commas")))
}

impl Question {
    /// The positions that it names.
    fn positions(&self) -> Vec<DVec3> {
        match self {
            Self::Objects(Place::Box(place)) => vec![(place.min + place.max) / 2.0],
            Self::Objects(Place::Sphere { center, .. }) => vec![*center],
            Self::Objects(Place::Along(_, robot)) => vec![robot.world_from_robot().translation],
            Self::Free(place) => vec![*place],
            Self::Way(from, to, ..) => vec![*from, *to],
            Self::Docks(_) | Self::Uncertain(_) => Vec::new(),
        }
    }

    fn of(args: &Args) -> Result<Self> {
        if let Some(text) = &args.in_box {
            let [a, b, c, d, e, f] = numbers("--box", text)?;
            return Ok(Self::Objects(Place::Box(Aabb { min: DVec3::new(a, b, c), max: DVec3::new(d, e, f) })));
        }
        if let Some(text) = &args.sphere {
            let [x, y, z, radius] = numbers("--sphere", text)?;
            return Ok(Self::Objects(Place::Sphere { center: DVec3::new(x, y, z), radius }));
        }
        if let Some(path) = &args.along {
            let corridor = files::read_corridor(path)?;
            let pose = args.pose.as_deref().map(|text| parse_pose(text).map_err(|e| e.at(format!("--pose {text}"))));
            let pose = match (corridor.frame(), pose.transpose()?) {
                (CorridorFrame::Robot, None) => {
                    let what = "--along: the corridor is in the robot's frame";
                    return Err(Error::usage(what, "give the robot's --pose x,y,z,roll_deg,pitch_deg,yaw_deg"));
                }
                (_, pose) => RobotPose::new(pose.unwrap_or(Pose::IDENTITY)),
            };
            return Ok(Self::Objects(Place::Along(corridor, pose)));
        }
        if let Some(text) = &args.free {
            return Ok(Self::Free(numbers::<3>("--free", text)?.into()));
        }
        if args.uncertain {
            let options = UncertainOptions::default().with_min_existence(args.below).with_time(args.time);
            return Ok(Self::Uncertain(options.with_since(args.since)));
        }
        if let Some([from, to]) = args.path.as_deref() {
            let seen = args.blocked.as_deref().map(read_seen).transpose()?.unwrap_or_default();
            let (from, to) = (numbers::<3>("--path", from)?, numbers::<3>("--path", to)?);
            let options = PathOptions::default()
                .with_radius(args.radius)
                .with_clearance(args.step)
                .with_height(args.height)
                .with_slope_deg(args.slope);
            return Ok(Self::Way(from.into(), to.into(), seen, options));
        }
        Ok(Self::Docks(args.apart))
    }

    /// The answer as JSON and as lines.
    fn answer(&self, world: &World) -> Result<(Value, Vec<String>)> {
        match self {
            Self::Objects(place) => objects(world, place),
            Self::Docks(apart) => groups(world, *apart),
            Self::Free(p) => free(world, *p),
            Self::Uncertain(options) => uncertain(world, options),
            Self::Way(from, to, seen, options) => path(world, *from, *to, seen, options),
        }
    }
}

fn pose_value(pose: &Pose) -> Value {
    json!({ "translation": pose.translation.to_array(), "rotation_xyzw": pose.rotation.to_array() })
}

fn objects(world: &World, place: &Place) -> Result<(Value, Vec<String>)> {
    let found = objects_in(world, place)?;
    let value = found.iter().map(|o| {
        json!({
            "name": o.name, "pose": pose_value(&o.world_from_object),
            "bounds": [o.bounds.min.to_array(), o.bounds.max.to_array()], "polygons": o.polygons, "along": o.along,
            "features": o.features, "confirmed": o.confirmed, "existence": o.existence, "pose_sigmas": o.pose_sigmas,
        })
    });
    let line = |o: &presight::query::ObjectFound| {
        let along = o.along.map_or(String::new(), |along| format!("{along:.2} m along: "));
        let known = match (o.features, o.existence, o.confirmed) {
            (0, ..) => String::new(),
            (n, existence, confirmed) => format!(
                ", {n} features, existence {:.2}, confirmed {} s",
                existence.unwrap_or(1.0),
                confirmed.unwrap_or(0.0)
            ),
        };
        format!("{along}{} ({} polygons{known})", o.name, o.polygons)
    };
    let mut lines: Vec<String> = found.iter().map(line).collect();
    if lines.is_empty() {
        lines.push("no object".to_owned());
    }
    Ok((json!({ "objects": value.collect::<Vec<_>>() }), lines))
}

fn groups(world: &World, apart: f64) -> Result<(Value, Vec<String>)> {
    let found = docks(world, apart)?;
    let value = found.iter().map(|d| {
        let reflectors = d.reflectors.iter().map(|(id, at)| json!({ "id": id, "at": at.to_array() }));
        json!({
            "name": d.name, "class": d.class, "pose": pose_value(&d.world_from_dock),
            "reflectors": reflectors.collect::<Vec<_>>(),
        })
    });
    let line = |d: &presight::query::Dock| {
        let (t, (.., yaw)) = (d.world_from_dock.translation, d.world_from_dock.rpy());
        let name = if d.name.is_empty() { "reflectors" } else { &d.name };
        let (count, degrees) = (d.reflectors.len(), yaw.to_degrees());
        format!(
            "{name}: {count} reflectors for {}, at {:.3}, {:.3}, {:.3}, facing {degrees:.1} degrees",
            d.class, t.x, t.y, t.z
        )
    };
    let mut lines: Vec<String> = found.iter().map(line).collect();
    if lines.is_empty() {
        lines.push("no dock".to_owned());
    }
    Ok((json!({ "docks": value.collect::<Vec<_>>() }), lines))
}

fn free(world: &World, p: DVec3) -> Result<(Value, Vec<String>)> {
    let nearest = surface_distance(world, p)?;
    let name = |object: u32| &world.environment().objects()[object as usize].name;
    Ok(match nearest {
        None => (json!({ "distance": null, "object": null }), vec!["no surface".to_owned()]),
        Some(n) => (
            json!({ "distance": n.distance, "object": name(n.object) }),
            vec![format!("{:.4} m to {}", n.distance, name(n.object))],
        ),
    })
}

fn uncertain(world: &World, options: &UncertainOptions) -> Result<(Value, Vec<String>)> {
    let found = uncertain_features(world, options)?;
    let value = found.iter().map(|u| {
        json!({
            "class": u.class, "id": u.id, "name": u.name, "object": u.object, "at": u.at.to_array(),
            "existence": u.existence, "confirmed": u.confirmed, "doubt": u.doubt.name(),
        })
    });
    let line = |u: &presight::query::UncertainFeature| {
        let name = u.name.as_deref().map_or(String::new(), |name| format!(" {name:?}"));
        let object = u.object.as_deref().map_or(String::new(), |object| format!(" of {object}"));
        format!(
            "{}: {} feature {}{name}{object}, existence {:.3}, confirmed {} s",
            u.doubt.name(),
            u.class,
            u.id,
            u.existence,
            u.confirmed
        )
    };
    let objects = uncertain_objects(world, options)?;
    let object_value = objects.iter().map(|o| {
        json!({
            "object": o.object, "mark": o.mark, "class": o.class, "existence": o.existence, "confirmed": o.confirmed,
            "doubt": o.doubt.name(),
        })
    });
    let object_line = |o: &presight::query::UncertainObject| {
        let mark = o.mark.as_deref().map_or(String::new(), |mark| format!(", mark {mark:?}"));
        let class = o.class.as_deref().map_or(String::new(), |class| format!(" for {class}"));
        let existence = o.existence.map_or(String::new(), |e| format!(", existence {e:.3}"));
        format!("{}: object {}{class}{mark}{existence}", o.doubt.name(), o.object)
    };
    let mut lines: Vec<String> = objects.iter().map(object_line).chain(found.iter().map(line)).collect();
    if lines.is_empty() {
        lines.push("no object or feature is uncertain".to_owned());
    }
    Ok((json!({ "objects": object_value.collect::<Vec<_>>(), "features": value.collect::<Vec<_>>() }), lines))
}

fn path(world: &World, from: DVec3, to: DVec3, seen: &[Aabb], options: &PathOptions) -> Result<(Value, Vec<String>)> {
    Ok(match find_path(world, from, to, seen, options).map_err(|e| e.at("--path"))? {
        FloorPath::Found { points, length } => {
            let place = |p: &DVec3| format!("{:.3}, {:.3}, {:.3}", p.x, p.y, p.z);
            let mut lines = vec![format!("a path of {length:.2} m:")];
            lines.extend(points.iter().map(place));
            let points: Vec<_> = points.iter().map(|p| p.to_array()).collect();
            (json!({ "found": true, "length": length, "points": points }), lines)
        }
        FloorPath::Blocked { reached, missing, object } => {
            let by = match object.as_deref() {
                Some(name) => format!("; {name} blocks it"),
                None if seen.is_empty() => "; the floor ends there".to_owned(),
                None => "; the floor ends there, or something was seen".to_owned(),
            };
            let line = format!("no path: {missing:.2} m are missing from {:.3}, {:.3}{by}", reached.x, reached.y);
            let value = json!({ "found": false, "reached": reached.to_array(), "missing": missing, "object": object });
            (value, vec![line])
        }
    })
}

/// Boxes around what a run of `supervise` saw, world, metres.
fn read_seen(path: &Path) -> Result<Vec<Aabb>> {
    #[derive(serde::Deserialize)]
    struct Line {
        #[serde(default)]
        intrusions: Vec<Seen>,
    }
    #[derive(serde::Deserialize)]
    struct Seen {
        extent_world: Option<[[f64; 3]; 2]>,
    }
    let mut seen = Vec::new();
    for (i, line) in read_settings(path)?.lines().enumerate() {
        let parsed: Line = serde_json::from_str(line).map_err(|e| {
            let remedy = "give the --out file of presight supervise";
            Error::invalid(format!("is not a line of supervision: {e}"), remedy)
                .at(format!("line {}", i + 1))
                .in_file(path)
        })?;
        let boxes = parsed.intrusions.into_iter().filter_map(|s| s.extent_world);
        seen.extend(boxes.map(|[min, max]| Aabb { min: min.into(), max: max.into() }));
    }
    Ok(seen)
}
