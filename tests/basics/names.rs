//! What the sources of crates define, and what a path in one of them stands for: as much of a compiler's name
//! resolution as is needed to list the types that a library's public items show.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use syn::visit::{self, Visit};
use syn::{Attribute, ImplItem, Item, TraitItem, UseTree, Visibility};

/// A path from the crate down to an item.
pub type Name = Vec<String>;

/// What a module holds.
#[derive(Default)]
struct Module {
    items: BTreeMap<String, Item>,
    /// Names of types that a macro defines, each with the capitalized words of its call, among which are the types that
    /// it shows.
    by_macro: BTreeMap<String, BTreeSet<String>>,
    /// Imported names, each with its path as written, and whether others may use it from here.
    uses: BTreeMap<String, (Name, bool)>,
    globs: Vec<Name>,
    /// Modules below, and whether they are public.
    below: BTreeMap<String, bool>,
}

/// The sources of some crates.
#[derive(Default)]
pub struct Sources {
    modules: BTreeMap<Name, Module>,
    /// Implementations, with the module in which they stand.
    impls: Vec<(Name, syn::ItemImpl)>,
}

/// True if the list of an attribute, such as `doc(hidden)`, has a word.
fn lists(attributes: &[Attribute], name: &str, word: &str) -> bool {
    let has_word = |a: &Attribute| match &a.meta {
        syn::Meta::List(list) => super::architecture::words(&list.tokens.to_string()).any(|w| w == word),
        _ => false,
    };
    attributes.iter().any(|a| a.path().is_ident(name) && has_word(a))
}

fn is_hidden(attributes: &[Attribute]) -> bool {
    lists(attributes, "doc", "hidden")
}

fn is_public(visibility: &Visibility) -> bool {
    matches!(visibility, Visibility::Public(_))
}

fn below(module: &[String], name: &str) -> Name {
    [module, &[name.to_owned()]].concat()
}

/// Name, visibility and attributes of an item that has a name.
fn parts(item: &Item) -> Option<(String, &Visibility, &[Attribute])> {
    let (name, visibility, attributes) = match item {
        Item::Struct(i) => (&i.ident, &i.vis, &i.attrs),
        Item::Enum(i) => (&i.ident, &i.vis, &i.attrs),
        Item::Trait(i) => (&i.ident, &i.vis, &i.attrs),
        Item::Type(i) => (&i.ident, &i.vis, &i.attrs),
        Item::Fn(i) => (&i.sig.ident, &i.vis, &i.attrs),
        Item::Const(i) => (&i.ident, &i.vis, &i.attrs),
        Item::Static(i) => (&i.ident, &i.vis, &i.attrs),
        Item::Mod(i) => (&i.ident, &i.vis, &i.attrs),
        _ => return None,
    };
    Some((name.to_string(), visibility, attributes))
}

impl Sources {
    /// Adds a crate with its name in code; `file` is its root.
    pub fn add(&mut self, name: &str, file: &Path) {
        self.add_file(vec![name.to_owned()], file, file.parent().unwrap());
    }

    /// Adds a crate that is one text.
    pub fn add_text(&mut self, name: &str, text: &str) {
        self.add_items(vec![name.to_owned()], syn::parse_file(text).unwrap().items, Path::new(""));
    }

    fn add_file(&mut self, module: Name, file: &Path, folder: &Path) {
        let text = fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let parsed = syn::parse_file(&text).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        self.add_items(module, parsed.items, folder);
    }

    fn add_items(&mut self, module: Name, items: Vec<Item>, folder: &Path) {
        self.modules.entry(module.clone()).or_default();
        for item in items {
            let attributes = parts(&item).map(|(.., attributes)| attributes).unwrap_or_default();
            let is_test = lists(attributes, "cfg", "test") && !lists(attributes, "cfg", "not");
            if is_test || is_hidden(attributes) {
                continue;
            }
            match item {
                Item::Mod(m) => self.add_module(&module, m, folder),
                Item::Impl(i) => self.impls.push((module.clone(), i)),
                Item::Use(u) => self.add_use(&module, Vec::new(), &u.tree, is_public(&u.vis)),
                Item::Macro(m) => self.add_macro(&module, &m.mac.tokens.to_string()),
                item => {
                    if let Some(name) = parts(&item).map(|(name, ..)| name) {
                        self.at(&module).items.insert(name, item);
                    }
                }
            }
        }
    }

    fn at(&mut self, module: &Name) -> &mut Module {
        self.modules.get_mut(module).expect("a module")
    }

    fn add_module(&mut self, module: &Name, m: syn::ItemMod, folder: &Path) {
        let word = m.ident.to_string();
        self.at(module).below.insert(word.clone(), is_public(&m.vis));
        let inner = folder.join(&word);
        match m.content {
            Some((_, items)) => self.add_items(below(module, &word), items, &inner),
            None => {
                let files = [folder.join(format!("{word}.rs")), inner.join("mod.rs")];
                let file = files.iter().find(|f| f.is_file()).unwrap_or_else(|| panic!("no {}", inner.display()));
                self.add_file(below(module, &word), file, &inner);
            }
        }
    }

    /// Adds the types that the text in a macro's call may define: a name before a brace.
    fn add_macro(&mut self, module: &Name, text: &str) {
        fn is_name_of_type(word: &&str) -> bool {
            word.starts_with(char::is_uppercase) && word.chars().all(char::is_alphanumeric)
        }
        // Without string literals, which hold the docs.
        let code: String = text.replace("\\\"", "").split('"').step_by(2).collect();
        // A type comes after one of these; a variant does not.
        let after = code.split([':', '<', '&', '(']).skip(1).filter_map(|part| {
            let word = part.trim_start().split(|c: char| !c.is_alphanumeric()).next()?;
            Some(word).filter(is_name_of_type)
        });
        let shown: BTreeSet<String> = after.map(str::to_owned).collect();
        let before = code.split('{').filter_map(|part| part.split_whitespace().last()).filter(is_name_of_type);
        let types: Vec<_> = before.map(|word| (word.to_owned(), shown.clone())).collect();
        self.at(module).by_macro.extend(types);
    }

    fn add_use(&mut self, module: &Name, path: Name, tree: &UseTree, public: bool) {
        match tree {
            UseTree::Path(p) => self.add_use(module, below(&path, &p.ident.to_string()), &p.tree, public),
            UseTree::Group(g) => g.items.iter().for_each(|t| self.add_use(module, path.clone(), t, public)),
            UseTree::Glob(_) => self.at(module).globs.push(path),
            UseTree::Name(n) if n.ident == "self" => {
                let name = path.last().expect("a path before self").clone();
                self.at(module).uses.insert(name, (path, public));
            }
            UseTree::Name(n) => {
                let name = n.ident.to_string();
                self.at(module).uses.insert(name.clone(), (below(&path, &name), public));
            }
            UseTree::Rename(r) => {
                let path = if r.ident == "self" { path } else { below(&path, &r.ident.to_string()) };
                self.at(module).uses.insert(r.rename.to_string(), (path, public));
            }
        }
    }

    /// The place of the definition that a path in a module stands for; `None` outside of these crates.
    fn resolve(&self, module: &[String], path: &[String], depth: usize) -> Option<Name> {
        // Imports that name each other in a circle end here.
        let (first, rest) = path.split_first().filter(|_| depth < 20)?;
        let here = self.modules.get(module)?;
        let start = match first.as_str() {
            "crate" => module[..1].to_vec(),
            "self" => module.to_vec(),
            "super" => module[..module.len() - 1].to_vec(),
            _ if here.items.contains_key(first) || here.by_macro.contains_key(first) => below(module, first),
            // A function may have the name of a module.
            _ if here.below.contains_key(first) && !(rest.is_empty() && here.uses.contains_key(first)) => {
                below(module, first)
            }
            _ => match here.uses.get(first) {
                Some((to, _)) => self.resolve_use(module, to, depth + 1)?,
                None if self.modules.contains_key(&path[..1]) => path[..1].to_vec(),
                None => {
                    let of_glob = |glob: &Name| self.resolve_use(module, glob, depth + 1);
                    return here.globs.iter().filter_map(of_glob).find_map(|m| self.resolve(&m, path, depth + 1));
                }
            },
        };
        if rest.is_empty() { Some(start) } else { self.resolve(&start, rest, depth + 1) }
    }

    /// As `resolve`, for the path of an import: a crate comes first.
    fn resolve_use(&self, module: &[String], path: &[String], depth: usize) -> Option<Name> {
        match (self.modules.contains_key(&path[..1]), &path[1..]) {
            (true, []) => Some(path.to_vec()),
            (true, rest) => self.resolve(&path[..1], rest, depth),
            (false, _) => self.resolve(module, path, depth),
        }
    }

    fn item(&self, name: &[String]) -> Option<&Item> {
        let (last, module) = name.split_last()?;
        self.modules.get(module)?.items.get(last)
    }

    /// True for a type or a trait.
    pub fn is_type(&self, name: &[String]) -> bool {
        let by_macro = || {
            let (last, module) = name.split_last()?;
            Some(self.modules.get(module)?.by_macro.contains_key(last))
        };
        match self.item(name) {
            Some(item) => matches!(item, Item::Struct(_) | Item::Enum(_) | Item::Trait(_) | Item::Type(_)),
            None => by_macro().unwrap_or(false),
        }
    }

    /// The public modules of a crate, itself first, and imports that do not name one item.
    pub fn modules(&self, of_crate: &str) -> (Vec<Name>, Vec<String>) {
        let (mut modules, mut globs) = (vec![vec![of_crate.to_owned()]], Vec::new());
        let mut next = 0;
        while let Some(module) = modules.get(next).cloned() {
            let here = &self.modules[&module];
            modules.extend(here.below.iter().filter(|(_, public)| **public).map(|(name, _)| below(&module, name)));
            globs.extend(here.globs.iter().map(|glob| format!("{}: {}::*", module.join("::"), glob.join("::"))));
            let public = here.uses.iter().filter(|(_, (_, public))| *public);
            let is_one = |to: Name| self.item(&to).is_some() || self.is_type(&to);
            let whole = public.filter(|(_, (path, _))| !self.resolve_use(&module, path, 0).is_some_and(is_one));
            globs.extend(whole.map(|(name, _)| format!("{}: {name}", module.join("::"))));
            next += 1;
        }
        (modules, globs)
    }

    /// What a crate's public modules offer: the public name and the place of its definition.
    pub fn offered(&self, of_crate: &str) -> Vec<(Name, Name)> {
        let mut found = Vec::new();
        for module in self.modules(of_crate).0 {
            let here = &self.modules[&module];
            let own = here.items.iter().filter(|(_, item)| parts(item).is_some_and(|(_, vis, _)| is_public(vis)));
            found.extend(own.map(|(name, _)| (below(&module, name), below(&module, name))));
            for (name, (path, _)) in here.uses.iter().filter(|(_, (_, public))| *public) {
                found.extend(self.resolve_use(&module, path, 0).map(|to| (below(&module, name), to)));
            }
        }
        found
    }

    /// The types and traits that an item's public face shows, each with the member that shows it.
    pub fn shown(&self, name: &[String]) -> Vec<(String, Name)> {
        let (last, module) = name.split_last().expect("a name");
        let mut members = Members::default();
        match self.item(name) {
            Some(Item::Struct(s)) => {
                let public = s.fields.iter().filter(|f| is_public(&f.vis) && !is_hidden(&f.attrs));
                public.for_each(|f| members.add(&f.ident, |paths| paths.visit_type(&f.ty)));
            }
            Some(Item::Enum(e)) => {
                for v in e.variants.iter().filter(|v| !is_hidden(&v.attrs)) {
                    v.fields.iter().for_each(|f| members.add(&Some(&v.ident), |paths| paths.visit_type(&f.ty)));
                }
            }
            Some(Item::Fn(f)) => members.add(&Some(&f.sig.ident), |paths| paths.visit_signature(&f.sig)),
            Some(Item::Type(t)) => members.add(&Some(&t.ident), |paths| paths.visit_type(&t.ty)),
            Some(Item::Const(c)) => members.add(&Some(&c.ident), |paths| paths.visit_type(&c.ty)),
            Some(Item::Trait(t)) => {
                for item in &t.items {
                    if let TraitItem::Fn(f) = item {
                        members.add(&Some(&f.sig.ident), |paths| paths.visit_signature(&f.sig));
                    }
                }
            }
            Some(_) => {}
            None => {
                let by_macro = self.modules.get(module).and_then(|m| m.by_macro.get(last));
                members.0.extend(by_macro.into_iter().flatten().map(|word| ("macro".to_owned(), vec![word.clone()])));
            }
        }
        let mut shown: Vec<_> = members
            .0
            .into_iter()
            .filter_map(|(member, path)| Some((member, self.resolve(module, &path, 0)?)))
            .collect();
        for (place, i) in self.impls.iter().filter(|(place, i)| self.self_of(place, i).as_deref() == Some(name)) {
            let members = Members::of(i).0.into_iter();
            shown.extend(members.filter_map(|(member, path)| Some((member, self.resolve(place, &path, 0)?))));
        }
        shown.into_iter().map(|(member, to)| (format!("{last}: {member}"), to)).collect()
    }

    fn self_of(&self, place: &Name, i: &syn::ItemImpl) -> Option<Name> {
        let syn::Type::Path(path) = &*i.self_ty else { return None };
        self.resolve(place, &path_of(&path.path), 0)
    }
}

fn path_of(path: &syn::Path) -> Name {
    path.segments.iter().map(|s| s.ident.to_string()).collect()
}

/// Members of an item, each with a path in its signature.
#[derive(Default)]
struct Members(Vec<(String, Name)>);

impl Members {
    fn add(&mut self, name: &Option<impl ToString>, see: impl FnOnce(&mut Paths)) {
        let mut paths = Paths::default();
        see(&mut paths);
        let name = name.as_ref().map_or("0".into(), ToString::to_string);
        self.0.extend(paths.0.into_iter().map(|path| (name.clone(), path)));
    }

    /// The public members of an implementation, and the types that a trait's implementation sets.
    fn of(i: &syn::ItemImpl) -> Self {
        let mut members = Self::default();
        for item in &i.items {
            match item {
                ImplItem::Fn(f) if i.trait_.is_none() && is_public(&f.vis) && !is_hidden(&f.attrs) => {
                    members.add(&Some(&f.sig.ident), |paths| paths.visit_signature(&f.sig));
                }
                ImplItem::Const(c) if i.trait_.is_none() && is_public(&c.vis) && !is_hidden(&c.attrs) => {
                    members.add(&Some(&c.ident), |paths| paths.visit_type(&c.ty));
                }
                ImplItem::Type(t) => members.add(&Some(&t.ident), |paths| paths.visit_type(&t.ty)),
                _ => {}
            }
        }
        members
    }
}

/// Paths of types and traits.
#[derive(Default)]
struct Paths(BTreeSet<Name>);

impl Visit<'_> for Paths {
    fn visit_path(&mut self, path: &syn::Path) {
        self.0.insert(path_of(path));
        visit::visit_path(self, path);
    }

    fn visit_attribute(&mut self, _: &Attribute) {}

    fn visit_expr(&mut self, _: &syn::Expr) {}
}
