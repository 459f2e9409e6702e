//! The limits on a script's text and on its names: each ends a script at once and reports the place.

use super::load;
use cpu_time::ThreadTime;
use presight_model::error::ErrorKind;
use std::fs;
use std::time::{Duration, Instant};

/// The thread's own time, because other tests run at the same time. It takes a second; parsing without limits takes
/// from a quarter of a minute to hours.
const SOON: Duration = Duration::from_secs(12);
/// The largest script.
const MEGABYTE: usize = 1 << 20;

fn loaded(text: &str) -> Result<usize, presight_model::error::Error> {
    let start = ThreadTime::now();
    let loaded = load_text(text);
    let took = start.elapsed();
    assert!(took < SOON, "{took:?} for {text:.60}");
    loaded
}

#[track_caller]
fn refused(text: &str, place: &str, parts: &[&str]) {
    let e = loaded(text).expect_err("a script that holds too much");
    let whole = e.to_string();
    assert_eq!((e.kind(), e.place()), (ErrorKind::Invalid, Some(place)), "{whole}");
    assert!(parts.iter().all(|part| whole.contains(part)) && !e.remedy().is_empty(), "{parts:?} are not in {whole}");
    assert!(whole.len() < 500 && !whole.contains('\n'), "{whole}");
}

/// As many repetitions as fit, with the text before and after.
fn filled(before: &str, one: impl Fn(usize) -> String, after: &str) -> String {
    let mut text = before.to_owned();
    for i in 0.. {
        let next = one(i);
        if text.len() + next.len() + after.len() > MEGABYTE {
            break;
        }
        text += &next;
    }
    text + after
}

#[test]
fn a_megabyte_of_one_kind_is_refused_at_once() {
    let same = |text: &'static str| move |_: usize| text.to_owned();
    // Columns of the thirteenth argument or parameter, the 257th variable or function, and the 1025th entry.
    refused(&filled("box(1", same(",1"), ");"), "line 1, column 29", &["a call has over 12 arguments"]);
    refused(&filled("fn g(p", |i| format!(",\np{i}"), ") {}"), "line 13, column 1", &["over 12 arguments"]);
    refused(&filled("", |i| format!("let v{i} = 1;\n"), ""), "line 257, column 5", &["over 256 variables"]);
    refused(&filled("", |i| format!("import \"m\" as v{i};\n"), ""), "line 257, column 15", &["256 variables"]);
    refused(&filled("", |i| format!("fn f{i}() {{}}\n"), ""), "line 257, column 1", &["over 256 functions"]);
    refused(&filled("", |i| format!("private fn f{i}() {{}}\n"), ""), "line 257, column 9", &["256 functions"]);
    refused(&filled("", |i| format!("let f = |a| a + {i};\n"), ""), "line 257, column 9", &["256 functions"]);
    refused(&filled("let g = |p", |i| format!(",\nq{i}"), "| 1;"), "line 1025, column 1", &["over 1024 entries"]);
    refused(&filled("switch 1 {\n0=>0", |i| format!(",\n{i}=>2"), "}"), "line 1026, column 1", &["1024 entries"]);
    refused(&filled("let a = #{\nb:0", |i| format!(",\na{i}:1"), "};"), "line 1026, column 1", &["1024 entries"]);
    refused(&filled("let a = [\n1", same(",\n1"), "];"), "line 4098, column 1", &["over 4096 elements"]);
    refused(&filled("let ", same("a"), " = 1;"), "line 1, column 5", &["a name is over 256 bytes"]);
    refused(&filled("let a = 1", same("a"), ";"), "line 1, column 10", &["a name is over 256 bytes"]);
}

#[test]
fn name_lookup_is_limited() {
    let known: String = (0..256).map(|i| format!("fn f{i}() {{}} let v{i} = 1;\n")).collect();
    refused(&filled(&known, |_| "a;".to_owned(), ""), "line 257, column 1", &["no variable \"a\""]);
    let maps = |i: usize| format!("#{{{}}};", (0..1000).map(|j| format!("k{i}{j}:1,")).collect::<String>());
    refused(&filled("", maps, ""), "at its end", &["places no polygons"]);
}

#[test]
fn large_scripts_of_ordinary_calls_are_read() {
    let places: String = (0..12_000).map(|i| format!("place(\"wall{i}\", b, pose({i}, 0, 0));\n")).collect();
    assert_eq!(loaded(&format!("let b = box(1, 1, 1);\n{places}")).unwrap(), 12_000);
    // The same variable again and again; variables of blocks; variables of functions in addition to the script's.
    let again: String = (0..5000).map(|i| format!("let p = pose({i}, 0, 0); place(\"w\", b, p);\n")).collect();
    let block = |i: usize| (0..50).map(|j| format!("let v{i}_{j} = 1;")).collect::<String>();
    let blocks: String = (0..20).map(|i| format!("{{{}}}\n", block(i))).collect();
    let own: String = (0..200).map(|i| format!("let w{i} = 1;")).collect();
    let text = format!("let b = box(1, 1, 1);\n{again}{blocks}fn f(x, y) {{ {own} }}\n{own} f(1, 2,);");
    assert_eq!(loaded(&text).unwrap(), 5000);
    // The maximum number of parameters, and a trailing comma.
    let twelve = "fn f(a, b, c, d, e, f, g, h, i, j, k, l) { l }\n";
    let call = "place(\"b\", box(f(1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12,), 1, 1));";
    assert_eq!(loaded(&format!("{twelve}{call}")).unwrap(), 1);
}

/// Each module has its own limits.
#[test]
fn modules_have_limits_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.rhai");
    let many: String = (0..200).map(|i| format!("fn f{i}() {{ rectangle(1, 1) }} let v{i} = 1;\n")).collect();
    fs::write(&path, format!("import \"m\" as m;\n{many}place(\"a\", m::f0());")).unwrap();
    fs::write(folder.path().join("m.rhai"), &many).unwrap();
    load(&path).0.unwrap();
    fs::write(folder.path().join("m.rhai"), format!("{many}box(1{});", ",1".repeat(50_000))).unwrap();
    let e = load(&path).0.unwrap_err().to_string();
    assert!(e.contains("m.rhai: line 201, column 29: a call has over 12 arguments"), "{e}");
    // Catching the error loses its place.
    let caught = format!("try {{ import \"m\" as m; }} catch {{}}\n{many}place(\"a\", f0());");
    fs::write(&path, caught).unwrap();
    load(&path).0.unwrap();
}

/// Seconds each; without limits the parser and the interpreter run for minutes, or take all memory.
#[test]
fn repeated_attempts_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.rhai");
    let said = |text: &str| {
        fs::write(&path, text).unwrap();
        let start = Instant::now();
        let e = load(&path).0.map(|_| ()).expect_err(text).to_string();
        assert!(start.elapsed() < 3 * SOON, "{:?} for {text:.60}", start.elapsed());
        e
    };
    // A megabyte each: the fifth is one too many.
    for i in 0..6 {
        let body = filled("fn f() {", |_| "a;".to_owned(), "}");
        fs::write(folder.path().join(format!("m{i}.rhai")), body).unwrap();
    }
    let imports: String = (0..6).map(|i| format!("import \"m{i}\" as m{i};\n")).collect();
    let e = said(&imports);
    assert!(e.contains("line 4") && e.contains("the script and its modules have over 4194304 bytes"), "{e}");
    // A file of 100 MB that is not a model.
    fs::File::create(folder.path().join("m.glb")).unwrap().set_len(100 << 20).unwrap();
    let e = said("loop { try { import_gltf(\"m.glb\"); } catch {} }");
    assert!(e.contains("operations"), "{e}");
    // Only the functions hold the values bound by `curry`.
    let start = "fn g(a) { 1 } let f = Fn(\"g\"); let a = []; a.pad(4000, 1); let x = [];\n";
    for text in [
        "loop { f = f.curry(a); }",
        "loop { f = f.curry(f); }",
        "for i in 0..4000 { x.push(f.curry(a)); } for i in 0..4000 { a.push(f.curry(x)); }",
    ] {
        let e = said(&format!("{start}{text}"));
        assert!(e.contains("line 2") && (e.contains("curried") || e.contains("operations")), "{e}");
    }
    assert!(load_ok("fn g(a, b) { a + b } let f = Fn(\"g\").curry(1); place(\"a\", box(f.call(2), 1, 1));"));
    // No function has this number of arguments, whatever their types.
    let e = said("loop { try { box(1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, [12]); } catch {} }");
    assert!(e.contains("operations"), "{e}");
    // The error does not list 60,000 names each time.
    let e = said(
        "for i in 0..60000 { material(`m${i}`); } let b = box(1, 1, 1); loop { try { b.made_of(\"m\"); } catch {} }",
    );
    assert!(e.contains("operations"), "{e}");
}

/// Values that the language does not report when it reads them, and files that would be read for nothing.
#[test]
fn nothing_large_is_copied_uncounted() {
    let table = "let a = []; a.pad(4000, 1);\n";
    let hidden = ["no `this` and no `global::`", "pass the value"];
    refused(&format!("fn f() {{ loop {{ let b = this; }} }}\n{table}a.f();"), "line 1, column 25", &hidden);
    refused(&format!("{table}a.map(|| this);"), "line 2, column 10", &hidden);
    refused("const A = [1];\nfn f() { loop { global::A; } }\nf();", "line 2, column 23", &hidden);
    refused("const A = [1];\nloop { global :: A; }", "line 2, column 15", &hidden);
    assert!(load_ok("let global = 2; place(\"a\", box(global, 1, 1));"), "a name like any other");
    let text = "y".repeat(5000);
    refused(&format!("\nloop {{ \"{text}\".to_upper(); }}"), "line 2, column 8", &["a string is over 4096 bytes"]);
    refused(&format!("loop {{ `{text}${{1}}`; }}"), "line 1, column 8", &["a string is over 4096 bytes"]);
    // Variables of modules are small, and may be read often.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.rhai");
    fs::write(&path, "import \"m\" as m;\nfor i in 0..100000 { m::A; }\nplace(\"a\", m::large());").unwrap();
    let large = "fn large() { let a = []; a.pad(4000, 1); box(a[3999], 1, 1) }";
    let module = |value: &str| fs::write(folder.path().join("m.rhai"), format!("export const A = {value};\n{large}"));
    module("[1, 2, [3, \"four\"]]").unwrap();
    load(&path).0.unwrap();
    for value in [format!("[{}1]", "1, ".repeat(64)), format!("#{{ a: [[{}1]] }}", "1, ".repeat(64))] {
        module(&value).unwrap();
        let e = load(&path).0.unwrap_err().to_string();
        assert!(e.contains("m.rhai: variable \"A\" of the module has over 64 elements; return it from"), "{e}");
    }
}

/// The clock ends a script whose steps no limit counts.
#[test]
fn a_script_that_only_copies_ends() {
    let chain = ".extract(0, 4000)".repeat(60);
    let start = Instant::now();
    let e = load_text(&format!("let a = []; a.pad(4000, 1); loop {{ a{chain}; }}")).unwrap_err().to_string();
    assert!(e.contains("the script takes over"), "{e}");
    let most = Duration::from_secs(presight_model::limits::MAX_SCRIPT_SECONDS) + SOON;
    assert!(start.elapsed() < most, "{:?}", start.elapsed());
}

fn load_text(text: &str) -> Result<usize, presight_model::error::Error> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.rhai");
    fs::write(&path, text).unwrap();
    load(&path).0.map(|scene| scene.environment.objects().len())
}

fn load_ok(text: &str) -> bool {
    loaded(text).is_ok()
}

/// The text of names also counts as memory.
#[test]
fn names_count_as_memory() {
    let long =
        |bytes: u32| format!("let n = \"x\"; n.pad({bytes}, \"y\"); let b = box(1, 1, 1); let a = assembly();\n");
    let hold = ["hold", "is the limit"];
    refused(
        &(long(16_000) + "for i in 0..65000 { material(n + i); }"),
        "line 2, column 21, in the call of material",
        &hold,
    );
    refused(
        &(long(4000) + "for i in 0..65000 { material(`m${i}`, #{ transparent: [n + 1, n + 2, n + 3] }); }"),
        "line 2, column 21, in the call of material",
        &hold,
    );
    refused(&(long(4000) + "for i in 0..250000 { a.add(n, b); }"), "line 2, column 24, in the call of add", &hold);
    refused(
        &(long(16_000) + "for i in 0..250000 { a.add(\"b\", b.point(\"video\", [0, 0, 1], #{ name: n })); }"),
        "line 2, column 35, in the call of point",
        &hold,
    );
    // The error does not list all of them.
    refused(
        &(long(16_000) + "for i in 0..5000 { material(n + i); }\nb.made_of(\"wood\");"),
        "line 3, column 3, in the call of made_of",
        &["there is no material \"wood\""],
    );
}
