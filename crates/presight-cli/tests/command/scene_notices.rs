//! Every command that reads a scene says once what of it is not followed.

use super::*;

const LINES: [&str; 3] = [
    "note: extension \"ACME_bend\" is not followed: the data without it is used (1 object)",
    "note: morph targets are not followed: the base shape is used (1 object)",
    "note: see-through materials are opaque here: \"glass\" (1 object); to change that, write \
     material.\"glass\".classes.laser = \"transparent\" below format = 1 in",
];

/// The wall with parts that are not followed.
fn bent() -> Vec<u8> {
    let change = |root: &mut Value| {
        root["extensionsUsed"] = json!(["ACME_bend"]);
        root["nodes"][0]["extensions"] = json!({"ACME_bend": {}});
        root["materials"] = json!([{"name": "glass", "alphaMode": "BLEND"}]);
        root["meshes"][0]["primitives"][0]["material"] = json!(0);
        root["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": 0}]);
    };
    wall(change, WALL, WALL_INDICES)
}

#[test]
fn each_line_comes_once_from_every_command() {
    let place = Place::new();
    place.write("bent.glb", &bent());
    place.write("drive.tum", b"0 0 0 1 0 0 0 1\n1 0.5 0 1 0 0 0 1\n");
    let mut commands = vec![
        "inspect bent.glb".to_owned(),
        "inspect bent.glb --json".to_owned(),
        format!("predict bent.glb {VIEW} --out a.exr"),
        "predict bent.glb --sensor laser-scanner --poses drive.tum --backend cpu --out b{i}.exr".to_owned(),
        "compare a.exr a.exr --scene bent.glb".to_owned(),
        "features bent.glb --class laser --out edges.json".to_owned(),
        "simulate bent.glb --sensor laser-scanner --poses drive.tum --out run".to_owned(),
        "localize run/scans.jsonl --map bent.glb --init reference --out c.tum".to_owned(),
        "batch bent.glb --poses drive.tum --sensor laser-scanner --out images".to_owned(),
    ];
    if cfg!(feature = "store") {
        commands.push("env create a.presight bent.glb".to_owned());
        commands.push("env create b.presight wall.glb".to_owned());
        commands.push("env import b.presight bent.glb --replace".to_owned());
    }
    for line in commands {
        let outcome = place.run(&line);
        let wanted = usize::from(!line.contains("wall.glb"));
        for words in LINES {
            let found = outcome.stderr.lines().filter(|said| said.starts_with(words)).count();
            assert_eq!(found, wanted, "{line}: {words}\n{}", outcome.stderr);
        }
        // A single wall does not determine a pose.
        let may_fail = line.starts_with("localize");
        assert!(may_fail || outcome.status == Some(0), "{line}\n{}", outcome.stderr);
    }
    if cfg!(feature = "store") {
        let line = b"{\"op\":\"insert_object\",\"object\":\"x\",\"from\":\"bent.glb\"}\n{\"op\":\"insert_object\",\"object\":\"y\",\"from\":\"bent.glb\"}\n";
        place.write("more.jsonl", line);
        let said = place.run("env apply b.presight more.jsonl").stderr;
        assert!(said.starts_with("note: bent.glb: extension") && said.lines().count() == 3, "{said}");
    }
    if cfg!(feature = "script") {
        place.write("hall.rhai", b"place(\"a\", import_gltf(\"bent.glb\"));");
        let said = place.run("inspect hall.rhai").stderr;
        assert!(said.starts_with("note: bent.glb: extension \"ACME_bend\" is not followed"), "{said}");
    }
    // The line that the notice gives silences it.
    place.write("bent.materials.toml", b"format = 1\nmaterial.\"glass\".classes.laser = \"transparent\"\n");
    let said = place.run("inspect bent.glb").stderr;
    assert_eq!((said.lines().count(), said.contains("see-through")), (2, false), "{said}");
}
