//! The facade is what users meet: it stays small, names every type that it shows, and its own command needs nothing
//! below it.

use super::architecture::{PICTURE, code, folder_of, read, root, sources, words};
use super::names::{Name, Sources};
use std::collections::{BTreeMap, BTreeSet};

/// The maximum numbers of modules, of types, and of names at the root.
const FACADE: [usize; 3] = [17, 263, 52];

/// Crates that programs around presight may name besides the facade: pictures and studies, and what they run.
const BESIDE: [&str; 4] = ["presight_pictures", "presight_studies", "presight_editor", "presight_cli"];

/// The sources that use presight as its users do.
const USERS: [&str; 4] = ["crates/presight-cli/src", "crates/presight-editor/src", "python/src", "examples"];

fn all_sources() -> Sources {
    let mut all = Sources::default();
    for (name, _) in PICTURE.iter().take_while(|(name, _)| *name != "presight-testkit") {
        all.add(&name.replace('-', "_"), &folder_of(name).join("src/lib.rs"));
    }
    all
}

/// What breaks the rules on a facade in `sources`: too many names, types without a name or with the name of another.
fn faults(sources: &Sources, facade: &str, bounds: [usize; 3]) -> Vec<String> {
    let (modules, mut faults) = sources.modules(facade);
    let offered = sources.offered(facade);
    let mut types = BTreeMap::<Name, Name>::new();
    types.extend(offered.iter().filter(|(_, at)| sources.is_type(at)).map(|(public, at)| (at.clone(), public.clone())));
    let at_root = modules.len() - 1 + offered.iter().filter(|(public, _)| public.len() == 2).count();
    let counts = [("modules", modules.len() - 1), ("types", types.len()), ("names at the root", at_root)];
    for ((what, count), max) in counts.into_iter().zip(bounds) {
        if count > max {
            faults.push(format!("{count} {what}, at most {max} are allowed"));
        }
    }
    let mut by_name = BTreeMap::<&String, Vec<String>>::new();
    types.iter().for_each(|(at, name)| by_name.entry(&name[name.len() - 1]).or_default().push(at.join("::")));
    let shared = by_name.iter().filter(|(_, places)| places.len() > 1);
    faults.extend(shared.map(|(name, places)| format!("{name} stands for {}", places.join(" and "))));
    let mut nameless = BTreeMap::<Name, BTreeSet<String>>::new();
    for (member, shown) in offered.iter().flat_map(|(_, at)| sources.shown(at)) {
        if sources.is_type(&shown) && !types.contains_key(&shown) {
            nameless.entry(shown).or_default().insert(member);
        }
    }
    let by = |members: BTreeSet<String>| members.into_iter().collect::<Vec<_>>().join(", ");
    faults.extend(nameless.into_iter().map(|(at, m)| format!("{} has no name; shown by {}", at.join("::"), by(m))));
    faults
}

/// Crates below the facade that a source names.
fn named_crates(source: &str) -> BTreeSet<String> {
    let below: BTreeSet<String> = PICTURE.iter().map(|(name, _)| name.replace('-', "_")).collect();
    let code = code(source);
    let named = words(&code).filter(|word| *word != "presight" && below.contains(*word) && !BESIDE.contains(word));
    named.map(str::to_owned).collect()
}

#[test]
fn the_facade_is_small_and_names_every_type_that_it_shows() {
    let sources = all_sources();
    assert!(sources.offered("presight").len() > 100, "the facade was not read");
    let faults = faults(&sources, "presight", FACADE);
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn programs_around_presight_name_the_facade_alone() {
    let (mut faults, mut count) = (Vec::new(), 0);
    for path in USERS.iter().flat_map(|folder| sources(&root().join(folder))) {
        count += 1;
        faults.extend(named_crates(&read(&path)).iter().map(|name| format!("{}: {name}", path.display())));
    }
    assert!(count > 70, "{count} sources");
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn planted_faults_of_a_facade_are_found() {
    assert_eq!(named_crates("use presight::Pose;\nuse presight_pictures::png; // presight_model::Pose"), [].into());
    let named = named_crates("use presight_model::Pose;\nfn f() { presight_store::read() }");
    assert_eq!(named, ["presight_model".to_owned(), "presight_store".to_owned()].into());

    let below = "pub mod a { pub struct Shown { pub field: super::b::Other, hidden: Inner } struct Inner; }\n\
                 pub mod b { pub struct Other; pub enum Answer { Yes(Kind), #[doc(hidden)] No(Unseen) } \
                 pub struct Unseen; pub struct Kind; pub type Shown = u8; \
                 impl Other { pub fn kind(&self) -> Option<Kind> { None } } }\n\
                 names! { pub enum Made { A } }";
    let found = |facade: &str, bounds| {
        let mut sources = Sources::default();
        sources.add_text("below", below);
        sources.add_text("facade", facade);
        faults(&sources, "facade", bounds)
    };
    let most = [9; 3];
    assert!(found("pub use below::b::{Answer, Kind, Other}; pub use below::{Made, a::Shown};", most).is_empty());
    assert_eq!(found("pub use below::a::Shown;", most), ["below::b::Other has no name; shown by Shown: field"]);
    let nameless = "below::b::Kind has no name; shown by Answer: Yes, Other: kind";
    assert_eq!(found("pub use below::b::{Answer, Other};", most), [nameless]);
    let two = "pub use below::b::{Kind, Other}; pub use below::a::Shown; pub mod c { pub use below::b::Shown; }";
    assert_eq!(found(two, most), ["Shown stands for below::a::Shown and below::b::Shown"]);
    assert_eq!(found("pub use below::*;", most), ["facade: below::*"]);
    assert_eq!(found("pub use below::a;", most), ["facade: a"]);
    let counts = found("pub mod c { pub use below::b::Kind; }", [0; 3]);
    assert_eq!(counts.len(), 3, "{counts:?}");
}
