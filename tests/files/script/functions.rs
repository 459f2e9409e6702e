//! Calls every documented function: each case names one signature, and its script checks the result.

use super::{load, run};
use presight_model::environment::{Appearance, FeatureShape};
use presight_read::script::reference;

/// A signature and a script; a floor is placed before it.
const CASES: &[(&str, &str)] = &[
    (
        "box(size_x, size_y, size_z) -> shape",
        r#"near(box(2, 3, 0.5), [-1, -1.5, 0], [1, 1.5, 0.5]); count(box(1, 1, 1), 6);"#,
    ),
    (
        "wedge(size_x, size_y, height) -> shape",
        r#"near(wedge(2, 3, 4), [-1, -1.5, 0], [1, 1.5, 4]); count(wedge(1, 1, 1), 5);"#,
    ),
    (
        "pyramid(size_x, size_y, height) -> shape",
        r#"near(pyramid(2, 3, 4), [-1, -1.5, 0], [1, 1.5, 4]); count(pyramid(1, 1, 1), 5);"#,
    ),
    (
        "pyramid(size_x, size_y, height, top_x, top_y) -> shape",
        "count(pyramid(2, 2, 1, 1, 1), 6); count(pyramid(2, 2, 1, 1, 0), 5);",
    ),
    (
        "prism(sides, radius, height) -> shape",
        "near(prism(4, 1, 2), [-1, -1, 0], [1, 1, 2]); count(prism(6, 1, 1), 8);",
    ),
    ("cylinder(radius, height) -> shape", "near(cylinder(1, 2), [-1, -1, 0], [1, 1, 2]); count(cylinder(1, 1), 26);"),
    ("cylinder(radius, height, facets) -> shape", "count(cylinder(1, 1, 12), 14);"),
    (
        "cone(radius_bottom, radius_top, height) -> shape",
        "near(cone(1, 0, 2), [-1, -1, 0], [1, 1, 2]); count(cone(1, 0, 1), 25);",
    ),
    ("cone(radius_bottom, radius_top, height, facets) -> shape", "count(cone(1, 0.5, 1, 12), 14);"),
    ("sphere(radius) -> shape", "near(sphere(2), [-2, -2, -2], [2, 2, 2]); count(sphere(1), 288);"),
    ("sphere(radius, facets) -> shape", "count(sphere(1, 12), 72);"),
    (
        "tube(radius_outer, radius_inner, height) -> shape",
        "near(tube(1, 0.5, 2), [-1, -1, 0], [1, 1, 2]); count(tube(1, 0.5, 2), 96);",
    ),
    ("tube(radius_outer, radius_inner, height, facets) -> shape", "count(tube(1, 0.5, 2, 12), 48);"),
    (
        "extrude(outline, height) -> shape",
        "let l = extrude([[0, 0], [2, 0], [2, 1], [1, 1], [1, 3], [0, 3]], 0.5); near(l, [0, 0, 0], [2, 3, 0.5]); count(l, 10);",
    ),
    ("stairs(steps, width, run, rise) -> shape", "near(stairs(4, 1, 0.25, 0.5), [0, -0.5, 0], [1, 0.5, 2]);"),
    ("rectangle(size_x, size_y) -> shape", "near(rectangle(2, 4), [-1, -2, 0], [1, 2, 0]); count(rectangle(1, 1), 1);"),
    ("face(corners) -> shape", "near(face([[0, 0, 0], [1, 0, 2], [0, 1, 0]]), [0, 0, 0], [1, 1, 2]);"),
    ("translate(shape, x, y, z) -> shape", "near(box(2, 2, 2).translate(1, 2, 3), [0, 1, 3], [2, 3, 5]);"),
    (
        "rotate(shape, roll_deg, pitch_deg, yaw_deg) -> shape",
        "near(box(2, 4, 6).rotate(90, 0, 90), [0, -1, -2], [6, 1, 2]);",
    ),
    ("rotate_x(shape, roll_deg) -> shape", "near(box(2, 4, 6).rotate_x(90), [-1, -6, -2], [1, 0, 2]);"),
    ("rotate_y(shape, pitch_deg) -> shape", "near(box(2, 4, 6).rotate_y(90), [0, -2, -1], [6, 2, 1]);"),
    ("rotate_z(shape, yaw_deg) -> shape", "near(box(2, 4, 6).rotate_z(-90), [-2, -1, 0], [2, 1, 6]);"),
    ("transform(shape, pose) -> shape", "near(box(2, 4, 6).transform(pose(10, 0, 0, 90)), [8, -1, 0], [12, 1, 6]);"),
    (
        "scale(shape, factor) -> shape",
        "near(box(2, 4, 6).scale(0.5), [-0.5, -1, 0], [0.5, 1, 3]); place(\"mirrored\", wedge(1, 1, 1).scale(-1));",
    ),
    (
        "scale(shape, factor_x, factor_y, factor_z) -> shape",
        "near(wedge(2, 4, 6).translate(1, 0, 0).scale(-1, 1, 2), [-2, -2, 0], [0, 2, 12]);",
    ),
    (
        "join(shapes) -> shape",
        "let two = join([box(1, 1, 1), box(1, 1, 1).translate(2, 0, 0)]); near(two, [-0.5, -0.5, 0], [2.5, 0.5, 1]); count(two, 12);",
    ),
    (
        "repeat(shape, count, step_x, step_y, step_z) -> shape",
        "let five = box(1, 1, 1).repeat(5, 2, 0, 1); near(five, [-0.5, -0.5, 0], [8.5, 0.5, 5]); count(five, 30);",
    ),
    ("material(name) -> string", r#"require(material("paint") == "paint", "name"); material("paint");"#),
    (
        "material(name, options) -> string",
        r#"material("a", #{ reflection: 0.5, one_sided: true, color: [1, 0, 0.5], transparent: ["video", "laser"], invisible: "radar" });
           place("painted", box(1, 1, 1).made_of("a"));"#,
    ),
    ("made_of(shape, material) -> shape", r#"place("painted", box(1, 1, 1).made_of(material("b")));"#),
    ("place(name, thing) -> ()", r#"let a = box(1, 1, 1); place("a/b", a); place("a/b", a);"#),
    ("place(name, thing, pose) -> ()", r#"place("a", box(1, 1, 1), pose(1, 2, 3));"#),
    ("assembly() -> assembly", r#"count(assembly(), 0);"#),
    (
        "add(assembly, name, thing) -> ()",
        r#"let a = assembly(); a.add("x", box(1, 1, 1)); let b = a; b.add("y/z", a); count(a, 6); count(b, 12);"#,
    ),
    (
        "add(assembly, name, thing, pose) -> ()",
        r#"let a = assembly(); a.add("x", box(1, 1, 1), pose(1, 0, 0)); place("a", a, pose(0, 0, 0, 90));"#,
    ),
    ("pose() -> pose", "same(pose() * [1, 2, 3], [1, 2, 3]);"),
    ("pose(x, y, z) -> pose", "same(pose(1, 2, 3) * [1, 2, 3], [2, 4, 6]);"),
    ("pose(x, y, z, yaw_deg) -> pose", "same(pose(1, 0, 0, 90) * [1, 0, 0], [1, 1, 0]);"),
    (
        "pose(x, y, z, roll_deg, pitch_deg, yaw_deg) -> pose",
        "same(pose(0, 0, 0, 0, 90, 0) * [1, 0, 0], [0, 0, -1]); same(pose(1, 0, 0, 90, 0, 0) * pose(0, 1, 0) * [0, 1, 0], [1, 0, 2]);",
    ),
    ("inverse(pose) -> pose", "same(inverse(pose(1, 0, 0, 90)) * [1, 1, 0], [1, 0, 0]);"),
    (
        "import_gltf(file) -> assembly",
        r#"let room = import_gltf("room.glb"); require(polygons(room) > 1000, "polygons"); place("one", room); place("two", room, pose(20, 0, 0));"#,
    ),
    ("point(shape, class, at) -> shape", r#"place("p", box(1, 1, 1).point(["video", "laser"], [0, 0, 1]));"#),
    (
        "point(shape, class, at, options) -> shape",
        r#"place("p", box(1, 1, 1).point("video", [0, 0, 1], #{ id: 7, name: "n", sigma: [0.1, 0.2, 0.3], existence: 0.5, confirmed: 10, rate: 0.1, strength: 0.4, contrast: 0.3, normal: [0, 0, 2] }).rotate_z(90));"#,
    ),
    (
        "segment(shape, class, from, to) -> shape",
        r#"place("p", box(1, 1, 1).segment("video", [0.5, 0.5, 0], [0.5, 0.5, 1]));"#,
    ),
    (
        "segment(shape, class, from, to, options) -> shape",
        r#"place("p", box(1, 1, 1).segment("video", [0.5, 0.5, 0], [0.5, 0.5, 1], #{ sigma: 0.01 }));"#,
    ),
    (
        "patch(shape, class, corners) -> shape",
        r#"place("p", box(2, 2, 1).patch("video", [[0, 0, 1], [1, 0, 1], [0, 1, 1]]));"#,
    ),
    (
        "patch(shape, class, corners, options) -> shape",
        r#"place("p", box(2, 2, 1).patch("video", [[0, 0, 1], [1, 0, 1], [0, 1, 1]], #{ sigma: 0.01 }).scale(-1, 1, 1));"#,
    ),
    ("reflector(shape, class, at) -> shape", r#"place("p", box(1, 1, 1).reflector("laser", [0, 0, 1]));"#),
    (
        "reflector(shape, class, at, options) -> shape",
        r#"place("p", box(1, 1, 1).reflector("laser", [0, 0, 1], #{ normal: [0, 0, 1] }));"#,
    ),
    (
        "fiducial(shape, class, pose, side, family, code) -> shape",
        r#"place("p", box(1, 1, 1).fiducial("video", pose(0.5, 0, 0.5), 0.5, "DICT_4X4_50", 3));"#,
    ),
    (
        "fiducial(shape, class, pose, side, family, code, options) -> shape",
        r#"place("p", box(1, 1, 1).fiducial("video", pose(0, 0, 1, 0, -90, 0), 0.5, "DICT_4X4_50", 3, #{ name: "up" }));"#,
    ),
    (
        "require(condition, message) -> ()",
        r#"require(1 < 2, "arithmetic"); let caught = ""; try { require(1 > 2, "no"); } catch (e) { caught = `${e}`; } require(caught.contains("no"), "caught");"#,
    ),
    ("bounds(shape) -> map", "require(bounds(box(1, 2, 3)).max[2] == 3.0, \"top\");"),
    ("polygons(thing) -> int", "require(polygons(box(1, 1, 1)) == 6, \"six\");"),
    ("sin(x) -> float", "eq(sin(PI() / 6), 0.5); eq(sin(0), 0);"),
    ("cos(x) -> float", "eq(cos(PI() / 3), 0.5);"),
    ("tan(x) -> float", "eq(tan(PI() / 4), 1);"),
    ("asin(x) -> float", "eq(asin(1), PI() / 2);"),
    ("acos(x) -> float", "eq(acos(-1), PI());"),
    ("atan(x) -> float", "eq(atan(1), PI() / 4);"),
    ("atan2(y, x) -> float", "eq(atan2(-1, -1), -0.75 * PI());"),
    ("to_radians(deg) -> float", "eq(to_radians(180), PI());"),
    ("to_degrees(x) -> float", "eq(to_degrees(PI()), 180);"),
    ("PI() -> float", "eq(PI(), 3.14159265358979);"),
    ("sqrt(x) -> float", "eq(sqrt(9), 3); eq((16).sqrt(), 4);"),
    ("hypot(x, y) -> float", "eq(hypot(3, 4), 5);"),
    ("pow(x, y) -> float", "eq(pow(2, 10), 1024); eq(pow(2, -0.5), 0.707106781186548);"),
    ("exp(x) -> float", "eq(exp(1), 2.71828182845905);"),
    ("ln(x) -> float", "eq(ln(exp(2)), 2);"),
    ("floor(x) -> float", "eq(floor(-1.5), -2);"),
    ("ceil(x) -> float", "eq(ceil(-1.5), -1);"),
    ("round(x) -> float", "eq(round(2.5), 3);"),
    ("to_int(x) -> int", "require(to_int(-2.9) == -2, \"int\");"),
    ("to_float(x) -> float", "require(to_float(1) / 2 == 0.5, \"float\");"),
    (
        "rng(seed) -> rng",
        "let a = rng(1); let b = rng(1); let c = a; let x = a.uniform(0, 1); require(x == b.uniform(0, 1), \"same seed\"); require(c.uniform(0, 1) == b.uniform(0, 1), \"copies go on together\");",
    ),
    (
        "uniform(rng, low, high) -> float",
        "let r = rng(2); for i in 0..99 { let x = r.uniform(-1, 3); require(x >= -1 && x < 3, \"range\"); } let high = 1.0 + 2.220446049250313e-16; for i in 0..99 { require(r.uniform(1, high) <= high, \"clamped\"); } require(r.uniform(-0.3, 0.7) <= 0.7, \"clamped\"); let below = 0; for i in 0..99 { let x = r.uniform(-1.7e308, 1.7e308); require(x >= -1.7e308 && x <= 1.7e308, \"wide\"); if x < 0.0 { below += 1; } } require(below > 30 && below < 70, \"both halves\");",
    ),
    (
        "integer(rng, low, high) -> int",
        "let r = rng(3); let seen = [0, 0, 0]; for i in 0..99 { let k = r.integer(4, 6); seen[k - 4] += 1; } for n in seen { require(n > 10, \"fair\"); } let low = -9223372036854775807 - 1; let k = r.integer(low, 9223372036854775807); require(k != r.integer(low, 9223372036854775807), \"all whole numbers\");",
    ),
    (
        "chance(rng, share) -> bool",
        "let r = rng(4); let n = 0; for i in 0..1000 { if r.chance(0.25) { n += 1; } } require(n > 200 && n < 300, \"share\");",
    ),
];

/// Helper functions for the cases.
const HELPERS: &str = r#"
fn eq(a, b) { require(a - b < 1e-12 && b - a < 1e-12, `${a} is not ${b}`); }
fn same(a, b) { for i in 0..3 { eq(a[i], b[i]); } }
fn near(shape, low, high) { let b = bounds(shape); same(b.min, low); same(b.max, high); place("shape", shape); }
fn count(thing, n) { require(polygons(thing) == n, `${polygons(thing)} polygons, not ${n}`); }
place("floor", rectangle(1, 1));
"#;

#[test]
fn every_function_passes_its_case() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy("scenes/room.glb", folder.path().join("room.glb")).unwrap();
    let path = folder.path().join("scene.rhai");
    for (signature, text) in CASES {
        let name = signature.split('(').next().unwrap();
        assert!(text.contains(&format!("{name}(")), "the case of {signature} does not call it");
        std::fs::write(&path, format!("{HELPERS}{text}")).unwrap();
        let (outcome, _) = load(&path);
        assert!(outcome.is_ok(), "{signature}: {}", outcome.unwrap_err());
    }
}

/// The signatures in the documentation's table.
fn documented(text: &str) -> Vec<&str> {
    let code = |line: &'_ str| line.strip_prefix("| `").and_then(|l| l.split('`').next()).map(str::len);
    text.lines().filter_map(|line| Some(&line[3..3 + code(line)?])).filter(|s| s.contains(" -> ")).collect()
}

#[test]
fn registered_functions_are_documented_and_tested() {
    let reference = reference();
    let registered = documented(&reference);
    let tested: Vec<&str> = CASES.iter().map(|(signature, _)| *signature).collect();
    assert_eq!(registered, tested, "every function has a case, in the order of the table");
    let readme = std::fs::read_to_string("scenes/README.md").unwrap();
    assert!(readme.contains(&reference), "scenes/README.md does not hold the table; it is\n{reference}");
    // Planted fault: a list without one entry is not equal.
    assert_ne!(documented(&reference.replacen("| `box(", "| box(", 1)), registered);
}

#[test]
fn a_wrong_expectation_is_found() {
    for text in
        ["near(box(2, 3, 0.5), [-1, -1.5, 0], [1, 1.5, 0.6]);", "count(box(1, 1, 1), 7);", "eq(sin(1), cos(1));"]
    {
        assert!(run(&format!("{HELPERS}{text}")).is_err(), "{text}");
    }
}

#[test]
fn objects_have_paths_poses_and_shared_meshes() {
    let scene = run(r#"
        material("steel", #{ reflection: 0.5, transparent: "radar" });
        fn robot(bolt) {
            let r = assembly();
            r.add("base", box(1, 1, 1).made_of("steel"));
            r.add("arm", box(0.1, 0.1, 1), pose(0, 0, 1));
            r.add("bolts/bolt", bolt, pose(0.5, 0, 0));
            r.add("bolts/bolt", bolt, pose(-0.5, 0, 0));
            r
        }
        let bolt = cylinder(0.01, 0.05, 6);
        let r = robot(bolt);
        for i in 0..2 { place(`cell${i + 1}/robot`, r, pose(10 * i, 0, 0, 90)); }
    "#)
    .unwrap();
    let e = &scene.environment;
    let names: Vec<&str> = e.objects().iter().map(|o| o.name.as_str()).collect();
    let of_cell = |k: u32| ["base", "arm", "bolts/bolt", "bolts/bolt#2"].map(|n| format!("cell{k}/robot/{n}"));
    assert_eq!(names, [of_cell(1), of_cell(2)].concat());
    let at = |name: &str| e.object(name).unwrap().world_from_object.translation;
    assert!((at("cell2/robot/bolts/bolt") - glam::DVec3::new(10.0, 0.5, 0.0)).length() < 1e-12);
    let mesh = |name: &str| &e.object(name).unwrap().mesh;
    assert!(std::sync::Arc::ptr_eq(mesh("cell1/robot/bolts/bolt"), mesh("cell2/robot/bolts/bolt#2")));
    assert!(std::sync::Arc::ptr_eq(mesh("cell1/robot/base"), mesh("cell2/robot/base")));
    assert!(!std::sync::Arc::ptr_eq(mesh("cell1/robot/base"), mesh("cell1/robot/arm")));
    assert_eq!((scene.report.polygons_stored, scene.report.polygons_in_scene), (20, 56));
    let steel = &e.materials()[usize::from(mesh("cell1/robot/base").material(0))];
    assert_eq!(
        (steel.name.as_str(), steel.reflection, steel.appearance("radar")),
        ("steel", 0.5, Appearance::Transparent)
    );
    // Source numbers continue: 12 + 12 + 2 (10 + 4 + 4 ...) triangles an instance.
    let sources: Vec<u32> = e.objects().iter().map(|o| o.first_source).collect();
    assert_eq!(sources, [0, 12, 24, 44, 64, 76, 88, 108]);
}

/// Assemblies become groups at their places; a second one with the same name is another group.
#[test]
fn assemblies_are_groups_where_they_are_placed() {
    let scene = run(r#"
        let body = assembly();
        body.add("lid", box(1, 1, 0.1), pose(0, 0, 1));
        body.add("lid", box(1, 1, 0.1), pose(0, 0, 2));
        let cart = assembly();
        cart.add("body", body, pose(0, 0, 0.5));
        cart.add("body", body, pose(0, 5, 0.5));
        cart.add("wheel", cylinder(0.2, 0.1), pose(1, 0, 0));
        place("cart", cart, pose(10, 0, 0, 90));
        place("cart", cart, pose(20, 0, 0));
        place("cart", box(1, 1, 1), pose(30, 0, 0));
        place("yard/cart", box(1, 1, 1), pose(40, 0, 0));
    "#)
    .unwrap();
    let e = &scene.environment;
    let names: Vec<&str> = e.objects().iter().map(|o| o.name.as_str()).collect();
    let of_cart = ["body/lid", "body/lid#2", "body#2/lid", "body#2/lid#2", "wheel"];
    let of = |cart: &str| of_cart.map(|part| format!("{cart}/{part}"));
    assert_eq!(names, [&of("cart")[..], &of("cart#2"), &["cart#3".to_owned(), "yard/cart".to_owned()]].concat());
    let given: Vec<&str> = e.framed_groups().map(|(path, _)| path).collect();
    assert_eq!(given, ["cart", "cart#2", "cart#2/body", "cart#2/body#2", "cart/body", "cart/body#2"]);
    let at = |path: &str| e.frame(path).unwrap().translation;
    for (path, x, y, z) in [
        ("cart", 10.0, 0.0, 0.0),
        ("cart/body#2", 5.0, 0.0, 0.5),
        ("cart#2/body#2", 20.0, 5.0, 0.5),
        ("yard", 0.0, 0.0, 0.0),
    ] {
        assert!((at(path) - glam::DVec3::new(x, y, z)).length() < 1e-12, "{path}: {}", at(path));
    }
    let mut world = presight_model::world::World::new(e.clone());
    let to = presight_model::geometry::Pose::from_xyz_rpy(glam::DVec3::new(20.0, 0.0, 7.0), 0.0, 0.0, 0.0);
    world.apply(presight_model::change::Change::MoveObject { name: "cart#2".into(), world_from_object: to }).unwrap();
    let moved: Vec<&str> = world
        .environment()
        .objects()
        .iter()
        .zip(e.objects())
        .filter(|(a, b)| a.world_from_object != b.world_from_object)
        .map(|(a, _)| a.name.as_str())
        .collect();
    assert_eq!(moved, of("cart#2"));
}

/// The maximum number of objects with one name: numbering one takes no longer than placing it.
#[test]
fn many_things_of_one_name() {
    let start = std::time::Instant::now();
    let scene = run("let b = rectangle(1, 1); for i in 0..100000 { place(\"b\", b); }").unwrap();
    assert_eq!(scene.environment.objects().last().unwrap().name, "b#100000");
    assert!(start.elapsed().as_secs() < 60, "{:?}", start.elapsed());
}

#[test]
fn groups_of_imported_models_are_placed_with_them() {
    let folder = tempfile::tempdir().unwrap();
    let part =
        run("let a = assembly(); a.add(\"lid\", box(1, 1, 1), pose(1, 0, 0)); place(\"cart\", a, pose(0, 2, 0));")
            .unwrap();
    presight_read::gltf::write_glb(&folder.path().join("part.glb"), &part.environment).unwrap();
    let path = folder.path().join("scene.rhai");
    let text = "let p = import_gltf(\"part.glb\"); place(\"a\", p, pose(0, 0, 3, 90)); place(\"a\", p); let q = p; q.add(\"top\", box(1, 1, 1)); place(\"b\", q);";
    std::fs::write(&path, text).unwrap();
    let e = load(&path).0.unwrap().environment;
    let given: Vec<&str> = e.framed_groups().map(|(path, _)| path).collect();
    assert_eq!(given, ["a", "a#2/cart", "a/cart", "b/cart"], "a group with its parent's pose needs no frame");
    assert!(["a#2", "b"].iter().all(|path| e.frame(path) == Some(presight_model::geometry::Pose::IDENTITY)));
    let at = e.frame("a/cart").unwrap().translation;
    assert!((at - glam::DVec3::new(-2.0, 0.0, 3.0)).length() < 1e-12, "{at}");
}

#[test]
fn features_move_with_their_shapes_and_are_numbered() {
    let scene = run(r#"
        let post = box(0.2, 0.2, 1).reflector(["laser", "radar"], [0.1, 0, 0.5], #{ normal: [1, 0, 0], sigma: [0.1, 0.2, 0.3] }).rotate_z(90)
            .segment("video", [0.1, 0.1, 0], [0.1, 0.1, 1]).translate(0, 0, 2);
        place("a", post, pose(5, 0, 0));
        place("b", post, pose(6, 0, 0));
        place("c", box(1, 1, 1).point("laser", [0, 0, 1], #{ id: 2, name: "given" }));
        place("d", box(1, 1, 1).fiducial("video", pose(0.5, 0, 0.5), 0.4, "DICT_4X4_50", 3));
    "#)
    .unwrap();
    let e = &scene.environment;
    let classes: Vec<&str> = e.layers().iter().map(|l| l.class.as_str()).collect();
    assert_eq!(classes, ["laser", "radar", "video"]);
    let laser = &e.layer("laser").unwrap().features;
    let known: Vec<_> = laser.iter().map(|f| (f.id, f.object.as_deref().unwrap())).collect();
    assert_eq!(known, [(1, "a"), (2, "c"), (3, "b")]);
    let FeatureShape::Reflector { at, covariance } = &laser[0].shape else { panic!("{:?}", laser[0]) };
    assert!((*at - glam::DVec3::new(0.0, 0.1, 2.5)).length() < 1e-15, "{at}");
    assert!((covariance.x_axis.x - 0.04).abs() < 1e-15 && (covariance.y_axis.y - 0.01).abs() < 1e-15);
    assert_eq!(laser[0].properties.normal, Some(glam::DVec3::Y));
    let world = presight_model::world::World::new(e.clone());
    for layer in e.layers() {
        presight_features::place(&world, layer).expect("the features lie on their objects");
    }
}

#[test]
fn imported_objects_are_placed_with_their_materials() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy("scenes/room.glb", folder.path().join("room.glb")).unwrap();
    let path = folder.path().join("scene.rhai");
    std::fs::write(
        &path,
        r#"let room = import_gltf("room.glb"); place("a", room); place("b", room, pose(100, 0, 0));"#,
    )
    .unwrap();
    let scene = load(&path).0.unwrap();
    let alone = presight_read::gltf::import("scenes/room.glb", &Default::default()).unwrap();
    let (e, room) = (&scene.environment, &alone.environment);
    assert_eq!(e.objects().len(), 2 * room.objects().len());
    for (i, object) in room.objects().iter().enumerate() {
        let [a, b] = [&e.objects()[i], &e.objects()[i + room.objects().len()]];
        assert_eq!(a.name, format!("a/{}", object.name));
        assert!(std::sync::Arc::ptr_eq(&a.mesh, &b.mesh));
        assert_eq!(a.mesh.vertices(), object.mesh.vertices());
        assert_eq!(a.first_source, object.first_source);
        assert_eq!(b.world_from_object.translation.x, object.world_from_object.translation.x + 100.0);
        for k in 0..object.mesh.polygon_count() as u32 {
            let name =
                |e: &presight_model::environment::Environment, m: u16| e.materials()[usize::from(m)].name.clone();
            assert_eq!(name(e, a.mesh.material(k)), name(room, object.mesh.material(k)));
        }
    }
    assert_eq!(scene.report.triangles_in_scene, 2 * alone.report.triangles_in_scene);
    assert_eq!(scene.report.triangles_stored, alone.report.triangles_stored);
}

#[test]
fn printed_lines_are_returned() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.rhai");
    std::fs::write(&path, "print(\"one\"); debug(2);\nplace(\"f\", rectangle(1, 1)); for i in 0..2000 { print(i); }")
        .unwrap();
    let (outcome, said) = load(&path);
    outcome.unwrap();
    assert_eq!((said[0].as_str(), said.len()), ("one", 1001));
    assert!(said[1].ends_with(": 2") && said[1].contains("scene.rhai"), "{}", said[1]);
    assert!(said[1000].contains("left out"));
}

/// The first script in a Markdown file.
fn example(file: &str) -> String {
    let text = std::fs::read_to_string(file).unwrap();
    let from = text.split_once("```rhai\n").unwrap_or_else(|| panic!("{file} has no script")).1;
    from.split_once("```").unwrap().0.to_owned()
}

#[test]
fn the_examples_of_the_documentation_run() {
    let scene = run(&example("docs/scene-scripts.md")).unwrap();
    assert_eq!(scene.environment.objects().len(), 8);
    assert!(scene.environment.object("entrance/door/handle").is_some());
    // The other example imports from the scenes' folder.
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("parts")).unwrap();
    for part in ["dock", "profiles"] {
        let name = format!("parts/{part}.rhai");
        std::fs::copy(format!("scenes/{name}"), folder.path().join(name)).unwrap();
    }
    let path = folder.path().join("scene.rhai");
    std::fs::write(&path, example("scenes/README.md")).unwrap();
    assert_eq!(load(&path).0.unwrap().environment.objects().len(), 3);
}
