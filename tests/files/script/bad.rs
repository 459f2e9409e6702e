//! Invalid scripts: each gives a typed error with file, line, column, call and remedy, within bounded time.

use super::load;
use presight_model::error::{Error, ErrorKind};
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A folder with a script.
fn folder(text: &[u8]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("scene.rhai"), text).unwrap();
    folder
}

fn error_in(folder: &Path) -> Error {
    let start = Instant::now();
    let e = load(&folder.join("scene.rhai")).0.expect_err("a bad script");
    assert!(start.elapsed() < Duration::from_secs(100), "{e}: after {:?}", start.elapsed());
    assert!(e.file().is_some() && e.place().is_some() && !e.to_string().contains('\n'), "{e}");
    assert_eq!(e.kind(), ErrorKind::Invalid, "{e}");
    e
}

/// The error of a script that cannot be read as text.
fn error_in_any(folder: &Path) -> String {
    let e = load(&folder.join("scene.rhai")).0.expect_err("a bad script");
    assert!(e.kind() == ErrorKind::Invalid && e.file().is_some() && !e.remedy().is_empty(), "{e}");
    e.to_string()
}

/// Checks that the error contains all parts; the first is the place.
#[track_caller]
fn refused(text: &str, parts: &[&str]) {
    let e = error_in(folder(text.as_bytes()).path());
    let whole = e.to_string();
    assert!(e.place().unwrap().starts_with(parts[0]), "{:?} is not at {:?}", e.place(), parts[0]);
    for part in parts {
        assert!(whole.contains(part), "{part:?} is not in {whole}");
    }
    assert!(whole.contains("; "), "there is no remedy in {whole}");
}

#[test]
fn an_endless_loop() {
    refused("let a = 1;\n  loop { a += 1; }", &["line 2, column", "operations"]);
    refused("fn f() { while true {} }\nf();", &["line 2, column 1, in the call of f", "operations"]);
}

#[test]
fn deep_recursion() {
    refused("fn f(x) { f(x + 1) }\nf(1);", &["line 2, column 1, in the call of f", "32 levels"]);
    let deep = format!("let x = {}1{};", "(".repeat(500), ")".repeat(500));
    refused(&deep, &["line 1", "nest"]);
}

#[test]
fn a_thousand_million_polygons() {
    refused(
        "place(\"s\",\n sphere(1, 1000000000));",
        &["line 2, column 2, in the call of sphere", "facets is 1000000000"],
    );
    refused(
        "let b = repeat(repeat(sphere(1, 1024), 16384, 1, 0, 0), 1000, 0, 1, 0);",
        &["line 1", "in the call of repeat", "is the limit"],
    );
    let doubling = "let a = assembly(); a.add(\"x\", sphere(1));\nfor i in 0..40 { let b = assembly(); b.add(\"l\", a); b.add(\"r\", a); a = b; }";
    refused(doubling, &["line 2", "in the call of add", "is the limit"]);
    let many = "let s = box(1, 1, 1); let a = assembly(); a.add(\"x\", s);\nfor i in 0..17 { let b = assembly(); b.add(\"l\", a); b.add(\"r\", a); a = b; }\nfor i in 0..9 { place(\"a\", a); }";
    refused(many, &["line 3", "in the call of place", "the script places", "is the limit"]);
    refused(
        "let s = sphere(1, 256); let all = [];\nloop { all.push(s.translate(1, 0, 0)); }",
        &["line 2", "in the call of translate", "hold"],
    );
    refused(
        "let s = sphere(1, 1000);\nloop { s.translate(1, 0, 0); }",
        &["line 2", "in the call of translate", "has made"],
    );
}

#[test]
fn invalid_sizes() {
    refused("box(1, 0.0 / 0.0, 1);", &["line 1, column 1, in the call of box", "size_y is NaN"]);
    refused("box(1, 2, -3);", &["line 1", "height is -3"]);
    refused("box(1, 2, 1e300);", &["line 1", "1e12"]);
    refused("place(\"a\", box(1, 1, 1), pose(1.0 / 0.0, 0, 0));", &["line 1", "in the call of pose", "x is inf"]);
    refused("box(1, 1, 1).scale(0);", &["line 1", "factor is 0"]);
    refused("sqrt(-1);", &["line 1", "in the call of sqrt", "NaN"]);
    refused(
        "let p = pose(9e11, 0, 0); place(\"far\", box(1, 1, 1), p * p);",
        &["line 1", "in the call of place", "beyond"],
    );
    // A shape too small for the f32 coordinates at its place.
    refused(
        "place(\"a\", box(1e-4, 1, 1).translate(1e6, 0, 0));",
        &["line 1", "in the call of place", "object \"a\"", "no area"],
    );
}

#[test]
fn unknown_materials() {
    refused(
        "material(\"wood\");\nplace(\"a\", box(1, 1, 1).made_of(\"wod\"));",
        &["line 2", "in the call of made_of", "no material \"wod\"", "wood"],
    );
    refused("material(\"wood\", #{ reflexion: 1 });", &["line 1", "unknown key \"reflexion\"", "reflection"]);
    refused("material(\"wood\", #{ reflection: 2 });", &["line 1", "reflection factor 2"]);
    refused("material(\"wood\", #{ transparent: \"radar\", invisible: [\"radar\"] });", &["line 1", "both"]);
    refused("material(\"wood\", #{ color: [1, 2, 3] });", &["line 1", "color"]);
    refused("material(\"wood\"); material(\"wood\", #{ reflection: 0.5 });", &["line 1", "defined already"]);
}

#[test]
fn arguments_of_the_wrong_type_and_number() {
    refused("\n  box(\"a\", 2, 3);", &["line 2, column 3, in the call of box", "size_x is the string \"a\"", "number"]);
    refused("box(1, 2);", &["line 1", "called with 2 arguments", "box(size_x, size_y, size_z)"]);
    refused("bux(1, 2);", &["line 1", "no function bux"]);
    refused("place(\"a\", 3);", &["line 1", "thing is 3", "a shape or an assembly"]);
    refused("place(\"a\", box(1, 1, 1), [1, 2, 3]);", &["line 1", "pose is an array", "a pose"]);
    refused("place(\"/a\", box(1, 1, 1));", &["line 1", "not a valid object name"]);
    refused("let b = box(1, 1, 1); b.add(\"x\", b);", &["line 1", "assembly is a shape"]);
    refused("extrude([[0, 0], [1, 0], [1]], 1);", &["line 1", "outline[2]", "2 numbers"]);
    refused("extrude([[0, 0], [1, 1], [1, 0], [0, 1]], 1);", &["line 1", "meets side"]);
    refused("cylinder(1, 1, 2.5);", &["line 1", "facets is 2.5", "whole number"]);
    refused(
        "face([[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 0]]).translate(0, 0, 0); place(\"x\", face([[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 0]]));",
        &["line 1", "off the plane"],
    );
    refused(
        "box(1, 1, 1).fiducial(\"video\", pose(), 0.1, \"DICT_4X4_50\", 50);",
        &["line 1", "in the call of fiducial", "50"],
    );
    refused(
        "box(1, 1, 1).fiducial(\"video\", pose(), 0.1, \"tag36h11\", 5);",
        &["line 1", "in the call of fiducial", "tag36h11", "OpenCV"],
    );
    refused(
        "let s = box(1, 1, 1).point(\"video\", [0, 0, 1], #{ id: 4 });\nplace(\"a\", s); place(\"b\", s);",
        &["at its end: features for class \"video\"", "id 4 is given twice"],
    );
}

#[test]
fn errors_in_functions_name_their_callers() {
    refused(
        "fn leg(h) {\n  box(1, 1, h)\n}\nfn table(h) { leg(h) }\ntable(-1);",
        &["line 2, column 3, in the call of box, in leg called at line 4, in table called at line 5"],
    );
}

#[test]
fn failed_checks() {
    refused(
        "require(1 > 2, \"the hall is too small\");",
        &["line 1, column 1, in the call of require", "the hall is too small"],
    );
    refused("throw \"oops\";", &["line 1", "throws oops"]);
    let e = error_in(folder(b"let s = \"x\"; s.pad(9000, \"y\"); throw s;").path()).to_string();
    assert!(e.len() < 400 && e.contains("(9000 bytes)"), "{e}");
    refused("let a = 1;", &["at its end", "places no polygons"]);
}

#[test]
fn disabled_features() {
    refused("eval(\"1\");", &["line 1", "eval"]);
    refused("let x = 2.0 ** 0.5;", &["line 1", "**"]);
    for call in ["sleep(1)", "timestamp()", "parse_json(\"1\")", "exit()"] {
        refused(&format!("{call};"), &["line 1", "no function"]);
    }
}

#[test]
fn syntax_errors() {
    refused("let x = ((1 + 2;", &["line 1, column", "syntax error"]);
    refused("let x = y + 1;", &["line 1", "no variable \"y\""]);
    refused("let x = \"open", &["line 1", "syntax error"]);
}

#[test]
fn huge_strings_and_arrays() {
    refused("let s = \"x\";\nloop { s += s; }", &["line 2", "16384 bytes"]);
    refused("let s = [1];\nloop { s += s; }", &["line 2", "4096 elements"]);
    refused("let s = []; s.pad(1000000000, 1);", &["line 1", "4096 elements"]);
    refused("let s = [1]; loop { s = [s, s]; }", &["line 1", "4096 elements"]);
    refused("let m = #{}; for i in 0..10000 { let n = #{}; n[`k${i}`] = i; m.mixin(n); }", &["line 1", "1024 entries"]);
    let many: String = (0..300).map(|i| format!("let x{i} = 1;\n")).collect();
    refused(&many, &["line 257", "256 variables"]);
}

#[test]
fn random_numbers_from_empty_ranges() {
    refused("let r = rng(1);\nlet x = uniform(r, 2, 1);", &["line 2, column 9, in the call of uniform", "from 2 to 1"]);
    refused("let r = rng(1);\nlet x = integer(r, 2, 1);", &["line 2, column 9, in the call of integer", "from 2 to 1"]);
    // A single number is a valid range.
    refused("let r = rng(1);\nuniform(r, 1, 1); integer(r, 1, 1);", &["at its end", "places no polygons"]);
}

/// The language does not track positions inside an index expression.
#[test]
fn limits_are_reported_where_values_are_indexed() {
    refused("let m = [1, 2];\nlet i = 0;\nloop {\n  m[i] = 1;\n}", &["line 4, column", "operations"]);
    refused("let m = #{a: 1};\nloop {\n  m[\"a\"] = 1;\n}", &["line 3, column", "operations"]);
    refused("let m = #{a: [1]};\nloop {\n  try { m.a[0] = 1; } catch {}\n}", &["line 3, column", "operations"]);
    refused("let s = \"ab\";\nloop {\n  s[0] = 'c';\n}", &["line 3, column", "operations"]);
    // Without any variable.
    refused("loop {\n  [1, 2][0];\n}", &["line 2, column", "operations"]);
    // Setting an entry is checked against the limit at the map's next use.
    let filled =
        |n: u32| format!("let m = #{{}};\nfor i in 0..{n} {{\n  m[`k${{i}}`] = i;\n}}\nplace(\"a\", box(1, 1, 1));");
    refused(&filled(1026), &["line 3, column", "object map", "1024 entries"]);
    let full = folder(filled(1024).as_bytes());
    load(&full.path().join("scene.rhai")).0.expect("a map as large as it may be");
}

/// One step of the language on large values may cost as much as many, and counts as many.
#[test]
fn large_values_count_by_their_size() {
    let full = "let a = []; a.pad(4000, 1);";
    let map = "let m = #{}; for i in 0..1000 { m[`k${i}`] = i; }";
    let text = "let s = \"x\"; s.pad(16000, \"y\");";
    let random = "let a = []; let x = 1; for i in 0..4000 { x = (x * 1103515245 + 12345) & 0xffffff; a.push(x); }";
    let nested = "let a = []; for i in 0..2000 { a.push([]); }";
    let start = Instant::now();
    for loops in [
        format!("{full}\nloop {{ a == a; }}"),
        format!("{full}\nloop {{ let b = a; }}"),
        format!("{full}\nloop {{ a.contains(2); }}"),
        format!("{nested}\nloop {{ let b = a; }}"),
        format!("{random}\nloop {{ a.order(); }}"),
        format!("{map}\nloop {{ m == m; }}"),
        format!("{map}\nloop {{ m + m; }}"),
        format!("{text}\nloop {{ s.to_upper(); }}"),
        format!("fn f(a) {{ 1 }} {full}\nloop {{ f(a); }}"),
    ] {
        let before = start.elapsed();
        refused(&loops, &["line 2", "operations"]);
        let took = start.elapsed() - before;
        // It takes seconds; the clock would end it after two minutes.
        assert!(took < Duration::from_secs(60), "{took:?}: {loops}");
    }
    refused("let a = [];\nfor i in 0..16000 { a = [a]; }", &["line 2", "4096 elements"]);
    // Reading small values is free, and iterating over large ones is possible.
    let fine = format!(
        "{full} let sum = 0; for i in 0..4000 {{ sum += a[i]; }} for x in a {{ sum += x; }} place(\"f\", rectangle(sum, 1));"
    );
    load(&folder(fine.as_bytes()).path().join("scene.rhai")).0.unwrap();
}

/// A placed shape stays in memory even if the script forgets it.
#[test]
fn memory_of_placed_things_is_bounded() {
    refused(
        "let i = 0;\nloop { i += 1; place(\"s\", sphere(1.0 + i * 0.001, 256)); }",
        &["line 2", "in the call of place", "hold", "is the limit"],
    );
    let long = "let n = \"x\"; n.pad(4000, \"y\"); let b = box(1, 1, 1);";
    refused(
        &format!("{long}\nfor i in 0..250000 {{ place(n, b); }}"),
        &["line 2", "in the call of place", "hold", "is the limit"],
    );
    let noted = "let n = \"x\"; n.pad(16000, \"y\"); let b = box(1, 1, 1).point(\"video\", [0, 0, 1], #{ name: n });";
    refused(
        &format!("{noted}\nfor i in 0..250000 {{ place(\"b\", b); }}"),
        &["line 2", "in the call of place", "hold", "is the limit"],
    );
}

/// Parts added to a copy are lost, so placing the empty original must give an error.
#[test]
fn assemblies_without_parts() {
    let explained = ["assembly without parts", "a.add(name, thing)"];
    for (text, place) in [
        ("let a = assembly();\nplace(\"a\", a);", "line 2, column 1, in the call of place"),
        (
            "let a = [assembly()]; add(a[0], \"x\", box(1, 1, 1));\nplace(\"a\", a[0]);",
            "line 2, column 1, in the call of place",
        ),
        (
            "let m = #{ a: assembly() }; add(m.a, \"x\", box(1, 1, 1));\nplace(\"a\", m.a);",
            "line 2, column 1, in the call of place",
        ),
        ("let a = assembly();\na.add(\"b\", assembly());", "line 2, column 3, in the call of add"),
        ("const A = assembly(); add(A, \"x\", box(1, 1, 1));\nplace(\"a\", A);", "line 2"),
    ] {
        refused(text, &[&[place][..], &explained].concat());
    }
    refused("const A = assembly();\nA.add(\"x\", box(1, 1, 1));", &["line 2, column 3", "constant", "let"]);
    // The form that the error suggests works.
    let fine = "let a = [assembly()]; let m = #{ a: assembly() }; a[0].add(\"x\", box(1, 1, 1)); m.a.add(\"x\", box(1, 1, 1)); place(\"a\", a[0]); place(\"m\", m.a);";
    assert_eq!(load(&folder(fine.as_bytes()).path().join("scene.rhai")).0.unwrap().environment.objects().len(), 2);
}

/// Parts added to an unused copy are reported, even if something else is placed; any use of the copy is accepted.
#[test]
fn parts_that_are_lost() {
    let start = "let c = assembly(); c.add(\"base\", box(1, 1, 1)); let b = box(1, 1, 1);\n";
    for (text, column) in [
        ("let a = [c]; add(a[0], \"x\", b); place(\"a\", a[0]);", 14),
        ("let m = #{ a: c }; add(m.a, \"x\", b); place(\"a\", m.a);", 20),
        ("fn f(a) { a.add(\"x\", box(1, 1, 1)); 0 } f(c); place(\"c\", c);", 13),
        ("place(\"c\", c); c.add(\"x\", b);", 18),
        ("let d = c; d.add(\"x\", b); place(\"c\", c);", 14),
        ("let d = assembly(); d.add(\"c\", c); c.add(\"x\", b); place(\"d\", d);", 38),
    ] {
        let place = format!("line 2, column {column}, in the call of add");
        refused(&format!("{start}{text}"), &[&place, "part \"x\" is lost", "write a.add(name, part)"]);
    }
    for text in [
        "let a = [c]; a[0].add(\"x\", b); place(\"a\", a[0]);",
        "fn f(a) { a.add(\"x\", box(1, 1, 1)); a } place(\"c\", f(f(c))); place(\"c\", c);",
        "let d = c; d.add(\"x\", b); let e = d; e.add(\"y\", b); place(\"e\", e);",
        "place(\"c\", c); c.add(\"x\", b); place(\"c\", c);",
        "let d = c; d.add(\"x\", b); let e = assembly(); e.add(\"d\", d); place(\"b\", b);",
        "let d = c; d.add(\"x\", b); require(polygons(d) == 12, \"whole\"); place(\"c\", c);",
        // The script needs only one of two assemblies.
        "let d = assembly(); d.add(\"x\", b); place(\"c\", c);",
    ] {
        let folder = folder(format!("{start}{text}").as_bytes());
        load(&folder.path().join("scene.rhai")).0.unwrap_or_else(|e| panic!("{text}: {e}"));
    }
}

#[test]
fn features_off_their_polygons() {
    refused(
        "let s = box(1, 1, 1).point(\"video\", [0, 0, 1.5], #{ name: \"spot\" });\n\n  place(\"a/b\", s, pose(3, 0, 0));",
        &[
            "line 3, column 3, in the call of place: class \"video\": feature 1 \"spot\"",
            "the point is 0.500000 m off its polygons",
            "object \"a/b\"",
        ],
    );
    // All placed objects count, regardless of the order.
    let text =
        "place(\"a\", box(1, 1, 1).point(\"video\", [0, 0, 1.5]));\nplace(\"b\", box(1, 1, 1), pose(0, 0, 1.5));";
    load(&folder(text.as_bytes()).path().join("scene.rhai")).0.unwrap();
    let folder = folder(b"import \"m\" as m;\nm::f();");
    fs::write(
        folder.path().join("m.rhai"),
        "fn f() {\n  place(\"a\", box(1, 1, 1).reflector(\"laser\", [9, 0, 0]));\n}",
    )
    .unwrap();
    let e = error_in(folder.path()).to_string();
    assert!(e.contains("m.rhai: line 2, column 3, in the call of place: class \"laser\": feature 1"), "{e}");
}

#[test]
fn files_that_are_missing_or_outside() {
    refused("import_gltf(\"none.glb\");", &["line 1, column 1, in the call of import_gltf", "none.glb"]);
    refused("import \"none\" as x;", &["line 1", "none.rhai"]);
    for outside in ["../secret.glb", "/etc/passwd", "a/../../b.glb", ""] {
        refused(&format!("import_gltf(\"{outside}\");"), &["line 1", "in the call of import_gltf"]);
    }
    refused("import \"../secret\" as x;", &["line 1", "not a path inside"]);
    refused("import \"/tmp/secret\" as x;", &["line 1", "not a path inside"]);
}

#[cfg(unix)]
#[test]
fn links_that_lead_outside() {
    let secret = tempfile::tempdir().unwrap();
    fs::write(secret.path().join("m.rhai"), "fn f() { 1 }").unwrap();
    fs::copy("scenes/room.glb", secret.path().join("room.glb")).unwrap();
    for text in ["import \"m\" as m;", "import \"dir/m\" as m;", "import_gltf(\"room.glb\");"] {
        let folder = folder(text.as_bytes());
        std::os::unix::fs::symlink(secret.path().join("m.rhai"), folder.path().join("m.rhai")).unwrap();
        std::os::unix::fs::symlink(secret.path().join("room.glb"), folder.path().join("room.glb")).unwrap();
        std::os::unix::fs::symlink(secret.path(), folder.path().join("dir")).unwrap();
        let e = error_in(folder.path());
        assert!(e.to_string().contains("leads out of the scene's folder"), "{e}");
    }
    // A link within the folder is accepted.
    let folder = folder(b"import \"m\" as m; place(\"f\", rectangle(m::f(), 1));");
    fs::write(folder.path().join("real.rhai"), "fn f() { 1 }").unwrap();
    std::os::unix::fs::symlink(folder.path().join("real.rhai"), folder.path().join("m.rhai")).unwrap();
    load(&folder.path().join("scene.rhai")).0.unwrap();
}

/// The model is in the folder, and its buffer is a link out of it.
#[cfg(unix)]
#[test]
fn buffers_of_models_that_lead_outside() {
    let secret = tempfile::tempdir().unwrap();
    let corners = [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let bytes: Vec<u8> = corners.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
    let json = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"name":"n","mesh":0}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}],
        "bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"uri":"m.bin","byteLength":36}]}"#;
    fs::write(secret.path().join("m.bin"), &bytes).unwrap();
    let with_link_to = |target: &dyn Fn(&Path) -> std::path::PathBuf| {
        let folder = folder(b"place(\"m\", import_gltf(\"m.gltf\"));");
        fs::write(folder.path().join("m.gltf"), json).unwrap();
        fs::write(folder.path().join("real.bin"), &bytes).unwrap();
        std::os::unix::fs::symlink(target(folder.path()), folder.path().join("m.bin")).unwrap();
        folder
    };
    let e = error_in(with_link_to(&|_| secret.path().join("m.bin")).path());
    assert_eq!(e.kind(), ErrorKind::Invalid);
    for part in ["scene.rhai", "in the call of import_gltf", "m.gltf", "m.bin leads out of the scene's folder"] {
        assert!(e.to_string().contains(part), "{part} in {e}");
    }
    let folder = with_link_to(&|folder| folder.join("real.bin"));
    let aside = secret.path().join("m.materials.toml");
    fs::write(&aside, "format = 1").unwrap();
    std::os::unix::fs::symlink(&aside, folder.path().join("m.materials.toml")).unwrap();
    let e = error_in(folder.path());
    assert!(e.to_string().contains("m.materials.toml leads out of the scene's folder"), "{e}");
    // A link within the folder is accepted, and so is any link outside of scripts.
    let folder = with_link_to(&|folder| folder.join("real.bin"));
    load(&folder.path().join("scene.rhai")).0.unwrap();
    let outside = with_link_to(&|_| secret.path().join("m.bin"));
    presight_read::gltf::import(outside.path().join("m.gltf"), &Default::default()).unwrap();
}

#[test]
fn faulty_modules_are_named() {
    let import = |module: &[u8]| {
        let folder = folder(b"import \"m\" as m;\nm::f();");
        fs::write(folder.path().join("m.rhai"), module).unwrap();
        error_in(folder.path()).to_string()
    };
    let whole = import(b"fn f() {\n  box(0, 1, 1)\n}");
    assert!(whole.contains("m.rhai: line 2, column 3, in the call of box, in f called at"), "{whole}");
    assert!(whole.contains("line 2: size_x is 0"), "{whole}");
    let whole = import(b"fn f() {");
    assert!(whole.contains("m.rhai: line 1") && whole.contains("syntax error"), "{whole}");
    let whole = import(b"\nrequire(false, \"module\");");
    assert!(
        whole.contains("m.rhai: line 2, column 1") && whole.contains("imported at") && whole.contains("module"),
        "{whole}"
    );
    let whole = import(b"import \"m\" as m;");
    assert!(whole.contains("imports itself"), "{whole}");
    let whole = import(b"import \"scene\" as m;");
    assert!(whole.contains("imports itself"), "{whole}");
    let whole = import(b"// \xff");
    assert!(whole.contains("m.rhai: line 1, column 4: this is not UTF-8"), "{whole}");
}

/// A byte order mark before the text is not part of the script.
#[test]
fn a_byte_order_mark_is_skipped() {
    let text = "\u{feff}import \"m\" as m;\nplace(\"f\", m::f());";
    let folder = folder(text.as_bytes());
    fs::write(folder.path().join("m.rhai"), "\u{feff}fn f() { rectangle(1, 1) }").unwrap();
    load(&folder.path().join("scene.rhai")).0.unwrap();
    refused("\u{feff}  box(1, 2);", &["line 1, column 3, in the call of box"]);
}

/// A pipe without a writer would block for ever.
#[cfg(unix)]
#[test]
fn pipes_and_devices_instead_of_files() {
    let pipe = |name: &str, text: &str| {
        let folder = folder(text.as_bytes());
        let path = folder.path().join(name);
        let _ = fs::remove_file(&path);
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        let (e, name) = (error_in_any(folder.path()), path.file_name().unwrap().to_str().unwrap().to_owned());
        assert!(e.contains("this is a pipe or a device") && e.contains(&name), "{e}");
    };
    pipe("scene.rhai", "");
    pipe("m.rhai", "import \"m\" as m;");
    pipe("m.glb", "place(\"m\", import_gltf(\"m.glb\"));");
    for device in ["/dev/zero", "/dev/null"] {
        let folder = folder(b"");
        fs::remove_file(folder.path().join("scene.rhai")).unwrap();
        std::os::unix::fs::symlink(device, folder.path().join("scene.rhai")).unwrap();
        assert!(error_in_any(folder.path()).contains("this is a pipe or a device"));
    }
}

#[test]
fn a_script_that_is_not_text() {
    let e = error_in(folder(b"let a = 1;\nlet \xc3\xa4 = \xff;").path());
    assert_eq!(e.place(), Some("line 2, column 9"), "{e}");
    assert!(e.to_string().contains("UTF-8"));
    let large = folder(&vec![b' '; 1 << 21]);
    let e = load(&large.path().join("scene.rhai")).0.unwrap_err();
    assert!(e.to_string().contains("too large"), "{e}");
}
