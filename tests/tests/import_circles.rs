//! No import circles: of the modules of one folder, none leads back to itself through what its siblings import.
//!
//! Every Rust file of the crates and apps is parsed. A `use` line, or a path in code or in a macro, that leads from one child of a module
//! into another is an arrow between the two, whatever depth they import at; a name that the parent (or any module on the way) merely brings
//! in by `use` or `pub use` leads on to where it stands. A parent and its own children may know each other. What only tests have does
//! not count.
#![allow(clippy::unwrap_used, missing_docs)] // a failed unwrap is a failed test

mod sources;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use sources::{is_test, leaves, packages, parse, plain, rust_files};
use syn::visit::{self, Visit};

/// `raster::cpu` as `["raster", "cpu"]`.
type ModulePath = Vec<String>;

/// What a module's file holds: the names that it imports, and every path that it mentions, from the root of the crate.
#[derive(Default)]
struct Module {
    names: BTreeMap<String, ModulePath>,
    mentions: Vec<(String, ModulePath)>,
}

/// The modules of a package by their paths.
type Modules = BTreeMap<ModulePath, Module>;

/// Collects one file's imports and paths.
struct Collector<'a> {
    at: ModulePath,
    /// File and line of what is read.
    file: &'a str,
    modules: &'a mut Modules,
    /// Modules in files of their own that only tests have.
    tests: &'a mut BTreeSet<ModulePath>,
    /// Inside of a function `use` lines give no names to others.
    depth: usize,
}

/// The start of a path as the root of the crate sees it; `None` leads into another crate or names something local.
fn absolute(at: &[String], path: &[String]) -> Option<ModulePath> {
    let mut base = match path.first()?.as_str() {
        "crate" => Vec::new(),
        "self" => at.to_vec(),
        "super" => at[..at.len().checked_sub(1)?].to_vec(),
        _ => return None,
    };
    let mut rest = &path[1..];
    while rest.first().is_some_and(|s| s == "super") {
        base.pop()?;
        rest = &rest[1..];
    }
    base.extend_from_slice(rest);
    Some(base)
}

impl Collector<'_> {
    fn mention(&mut self, path: &[String], line: usize) {
        // A path that starts with neither may start with a module or name of this file.
        let path = absolute(&self.at, path).unwrap_or_else(|| [&self.at[..], path].concat());
        let place = format!("{}:{line}", self.file);
        self.modules.entry(self.at.clone()).or_default().mentions.push((place, path));
    }

    /// `crate::a::b` and `super::a` in the tokens of a macro.
    fn tokens(&mut self, tokens: proc_macro2::TokenStream) {
        use proc_macro2::TokenTree;
        let mut path: Vec<String> = Vec::new();
        let (mut colons, mut line) = (0, 0);
        let mut ended = Vec::new();
        for token in tokens {
            match token {
                TokenTree::Ident(i) => {
                    if colons != 2 {
                        ended.push((std::mem::take(&mut path), line));
                        line = i.span().start().line;
                    }
                    path.push(i.to_string());
                    colons = 0;
                }
                TokenTree::Punct(p) if p.as_char() == ':' => colons += 1,
                other => {
                    ended.push((std::mem::take(&mut path), line));
                    colons = 0;
                    if let TokenTree::Group(group) = other {
                        self.tokens(group.stream());
                    }
                }
            }
        }
        ended.push((path, line));
        for (path, line) in ended.into_iter().filter(|(p, _)| p.len() > 1) {
            self.mention(&path, line);
        }
    }
}

impl<'ast> Visit<'ast> for Collector<'_> {
    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        self.at.push(plain(&module.ident));
        if is_test(&module.attrs) {
            self.tests.insert(self.at.clone());
        } else if module.content.is_some() {
            self.modules.entry(self.at.clone()).or_default();
            visit::visit_item_mod(self, module);
        }
        self.at.pop();
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        if is_test(&item.attrs) {
            return;
        }
        let mut found = Vec::new();
        leaves(&item.tree, &[], &mut found);
        for (name, path) in found {
            self.mention(&path, item.use_token.span.start().line);
            let path = absolute(&self.at, &path).unwrap_or_else(|| [&self.at[..], &path].concat());
            if self.depth == 0 && name != "*" {
                self.modules.entry(self.at.clone()).or_default().names.insert(name, path);
            }
        }
    }

    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        if !is_test(&item.attrs) {
            visit::visit_item_fn(self, item);
        }
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        if !is_test(&item.attrs) {
            visit::visit_item_impl(self, item);
        }
    }

    fn visit_block(&mut self, block: &'ast syn::Block) {
        self.depth += 1;
        visit::visit_block(self, block);
        self.depth -= 1;
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let words: Vec<String> = path.segments.iter().map(|s| plain(&s.ident)).collect();
        if words.len() > 1 && path.leading_colon.is_none() {
            self.mention(&words, path.segments[0].ident.span().start().line);
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, m: &'ast syn::Macro) {
        self.tokens(m.tokens.clone());
        visit::visit_macro(self, m);
    }
}

/// Reads files, each with its module's path.
fn read(files: &[(ModulePath, String, syn::File)]) -> Modules {
    let mut modules = Modules::new();
    let mut tests = BTreeSet::new();
    for (at, file, source) in files {
        modules.entry(at.clone()).or_default();
        Collector { at: at.clone(), file, modules: &mut modules, tests: &mut tests, depth: 0 }.visit_file(source);
    }
    modules.retain(|at, _| !tests.iter().any(|t| at.starts_with(t)));
    modules
}

/// The module in which what a path names is written: the longest start of it that is a module, onward where that one only imports the
/// name.
fn home(modules: &Modules, path: &[String]) -> ModulePath {
    let mut path = path.to_vec();
    for _ in 0..16 {
        let module = (0..=path.len()).rev().find(|n| modules.contains_key(&path[..*n])).unwrap_or(0);
        let next = path.get(module).and_then(|name| modules[&path[..module]].names.get(name));
        match next {
            Some(target) if modules.keys().any(|m| !m.is_empty() && target.starts_with(m)) && *target != path => {
                path = [&target[..], &path[module + 1..]].concat();
            }
            _ => return path[..module].to_vec(),
        }
    }
    path
}

/// Arrows between the children of one module, each with the place of one import.
type Arrows = BTreeMap<String, BTreeMap<String, String>>;

/// The arrows between siblings, by their parent.
fn arrows(modules: &Modules) -> BTreeMap<ModulePath, Arrows> {
    let mut out: BTreeMap<ModulePath, Arrows> = BTreeMap::new();
    for (from, module) in modules {
        for (place, path) in &module.mentions {
            // Each module on the way counts: the one that is named and the one that what it hands on stands in.
            let named = (0..=path.len()).rev().find(|n| modules.contains_key(&path[..*n])).unwrap_or(0);
            for to in [path[..named].to_vec(), home(modules, path)] {
                let common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
                if common < from.len() && common < to.len() {
                    let siblings = out.entry(from[..common].to_vec()).or_default();
                    siblings.entry(to[common].clone()).or_default();
                    let of = siblings.entry(from[common].clone()).or_default();
                    of.entry(to[common].clone()).or_insert_with(|| place.clone());
                }
            }
        }
    }
    out
}

/// What can be reached from one child.
fn reached<'a>(arrows: &'a Arrows, from: &'a str) -> BTreeSet<&'a str> {
    let mut out = BTreeSet::new();
    let mut open = vec![from];
    while let Some(at) = open.pop() {
        open.extend(arrows[at].keys().map(String::as_str).filter(|next| out.insert(*next)));
    }
    out
}

/// One circle: the children that all lead to each other, and what to print of them.
struct Circle {
    parent: String,
    children: Vec<String>,
    text: String,
}

/// The circles of a package.
fn circles(modules: &Modules) -> Vec<Circle> {
    let mut out = Vec::new();
    for (parent, arrows) in arrows(modules) {
        let reach: BTreeMap<&str, BTreeSet<&str>> = arrows.keys().map(|c| (c.as_str(), reached(&arrows, c))).collect();
        let mut seen = BTreeSet::new();
        for child in reach.keys().filter(|c| reach[*c].contains(*c)) {
            let together: Vec<&str> = reach[child].iter().copied().filter(|o| reach[o].contains(child)).collect();
            if !seen.insert(together.clone()) {
                continue;
            }
            let lines: Vec<String> = together
                .iter()
                .flat_map(|from| arrows[*from].iter().map(move |(to, place)| (from, to, place)))
                .filter(|(_, to, _)| together.contains(&to.as_str()))
                .map(|(from, to, place)| format!("    {from} -> {to} ({place})"))
                .collect();
            out.push(Circle {
                parent: parent.join("::"),
                children: together.iter().map(|c| (*c).to_owned()).collect(),
                text: lines.join("\n"),
            });
        }
    }
    out
}

/// The module's path of a file in `src`.
fn module_of(file: &Path) -> ModulePath {
    let mut path: ModulePath =
        file.with_extension("").components().map(|c| c.as_os_str().to_str().unwrap().to_owned()).collect();
    if path.last().is_some_and(|last| last == "mod") || path.len() == 1 && ["lib", "main"].contains(&path[0].as_str()) {
        path.pop();
    }
    path
}

#[test]
fn no_folder_has_an_import_circle() {
    let mut wrong = Vec::new();
    for package in packages(&["crates", "apps"]) {
        let mut files = Vec::new();
        for file in rust_files(&package.src) {
            let source = parse(&file);
            // A module that only tests have says so in its file or where it is declared.
            if !is_test(&source.attrs) {
                let inside = file.strip_prefix(&package.src).unwrap();
                files.push((module_of(inside), inside.display().to_string(), source));
            }
        }
        let modules = read(&files);
        assert!(!modules.is_empty(), "{}: nothing was read", package.name);
        for circle in circles(&modules) {
            let (parent, children) = (&circle.parent, circle.children.join(", "));
            wrong.push(format!("{}: a circle in `{parent}` of {children}\n{}", package.name, circle.text));
        }
    }
    assert!(wrong.is_empty(), "import circles between siblings:\n{}", wrong.join("\n"));
}

/// The circles of a made-up tree of files, as "parent: children".
fn found(tree: &[(&str, &str)]) -> Vec<String> {
    let file =
        |(path, text): &(&str, &str)| (module_of(Path::new(path)), (*path).to_owned(), syn::parse_file(text).unwrap());
    let modules = read(&tree.iter().map(file).collect::<Vec<_>>());
    circles(&modules).iter().map(|c| format!("{}: {}", c.parent, c.children.join(" "))).collect()
}

#[test]
fn circles_are_found_at_every_level_however_the_import_is_written() {
    let lib = ("lib.rs", "mod a; mod b; pub use b::B;");
    let a = ("a.rs", "use crate::b::B; pub struct A;");
    assert_eq!(found(&[lib, a, ("b.rs", "use crate::a::A; pub struct B;")]), [": a b"]);
    assert_eq!(found(&[lib, a, ("b.rs", "use super::a::A; pub struct B;")]), [": a b"]);
    assert_eq!(found(&[lib, a, ("b.rs", "pub struct B(crate::a::A);")]), [": a b"]);
    assert_eq!(found(&[lib, a, ("b.rs", "pub fn b() { vec![crate::a::A]; }")]), [": a b"]);
    assert_eq!(found(&[lib, a, ("b/mod.rs", "mod c; pub struct B;"), ("b/c.rs", "use crate::a::A;")]), [": a b"]);
    assert_eq!(found(&[lib, a, ("b/mod.rs", "pub use crate::a::A; pub struct B;")]), [": a b"], "a pub use counts");
    assert_eq!(
        found(&[lib, ("a.rs", "use crate::B;"), ("b.rs", "use crate::a::x;")]),
        [": a b"],
        "a name that the root hands on leads to its home"
    );
    let inner = [
        ("lib.rs", "mod m;"),
        ("m/mod.rs", "mod c; mod d; mod e;"),
        ("m/c.rs", "use super::d;"),
        ("m/d.rs", "use super::e::E;"),
        ("m/e.rs", "use crate::m::c::C;"),
    ];
    assert_eq!(found(&inner), ["m: c d e"]);
}

#[test]
fn what_is_no_circle_is_left_alone() {
    let lib = ("lib.rs", "mod a; mod b; pub use b::B; pub struct R;");
    let a = ("a.rs", "use crate::b::B; use std::fmt; pub struct A;");
    assert_eq!(found(&[lib, a, ("b.rs", "pub struct B;")]), [""; 0]);
    assert_eq!(found(&[lib, a, ("b.rs", "use crate::R; pub struct B;")]), [""; 0], "a parent and its own child");
    assert_eq!(found(&[lib, a, ("b.rs", "#[cfg(test)] mod tests { use crate::a::A; } pub struct B;")]), [""; 0]);
    let inside = "#[cfg(all(test, unix))] mod tests { use crate::a::A; } pub struct B;";
    assert_eq!(found(&[lib, a, ("b.rs", inside)]), [""; 0]);
    let apart = [lib, a, ("b.rs", "#[cfg(test)] mod tests; pub struct B;"), ("b/tests.rs", "use crate::a::A;")];
    assert_eq!(found(&apart), [""; 0]);
    assert_eq!(
        found(&[lib, a, ("b/mod.rs", "mod c; pub use c::C; pub struct B;"), ("b/c.rs", "use super::B; pub struct C;")]),
        [""; 0],
        "a child and its parent"
    );
}
