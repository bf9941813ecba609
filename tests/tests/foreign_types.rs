//! No crate shows another crate's types: what a library can be asked for is made of std, nalgebra, serde and this workspace.
//!
//! A dependency that shows in a signature cannot be replaced or raised without breaking whoever uses us. This test reads the sources with
//! a Rust parser and looks at every signature that can be reached from outside: functions, fields, variants, aliases, constants, traits, and
//! what is implemented for public types. A name counts as foreign if it leads to a dependency by its full path, by a `use` of the same
//! file, or by an alias of the same file.
//!
//! What it cannot see: types that a macro writes, types behind `impl Trait` whose trait is ours, names that come in by a glob `use` or
//! through a private module of our own, and what is declared inside functions. An item counts as public if all modules around it are, or if a
//! `pub use` of the crate names it; items of the same name in private modules are looked at too, which errs on the strict side.
#![allow(clippy::unwrap_used, missing_docs)] // a failed unwrap is a failed test

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

mod sources;

use drex_tests::workspace_root;
use sources::{is_test, leaves, parse, plain};
use syn::visit::{self, Visit};

/// Crates whose types anybody may meet in our interfaces.
const EVERYWHERE: [&str; 2] = ["nalgebra", "serde"];

/// What else a crate may show, and why.
const HERE: [(&str, &str, &str); 3] = [
    (
        "drex-diffsim",
        "simba",
        "the traits that nalgebra is written over, implemented for our dual number; the version is nalgebra's",
    ),
    ("drex-diffsim", "num_traits", "the same"),
    ("drex-diffsim", "approx", "the same"),
];

/// Names to crates: what the `use` lines of a file bring in from dependencies.
type Names = BTreeMap<String, String>;

/// A file's module as it was parsed.
struct Module {
    /// `raster::cpu`, for messages.
    path: String,
    public: bool,
    items: Vec<syn::Item>,
}

/// Reads the modules of a crate from `src/lib.rs` on, those of tests left out.
fn modules(src: &Path) -> Vec<Module> {
    let mut out = Vec::new();
    let root = parse(&src.join("lib.rs"));
    collect(root.items, String::new(), src.to_path_buf(), true, &mut out);
    out
}

fn collect(items: Vec<syn::Item>, path: String, folder: PathBuf, public: bool, out: &mut Vec<Module>) {
    let mut own = Vec::new();
    for item in items {
        let syn::Item::Mod(module) = item else {
            own.push(item);
            continue;
        };
        if is_test(&module.attrs) {
            continue;
        }
        let name = plain(&module.ident);
        let inner = if path.is_empty() { name.clone() } else { format!("{path}::{name}") };
        let public = public && is_public(&module.vis);
        let below = folder.join(&name);
        let items = match module.content {
            Some((_, items)) => items,
            None => {
                let file = [folder.join(format!("{name}.rs")), below.join("mod.rs")].into_iter().find(|f| f.is_file());
                let file = file.unwrap_or_else(|| panic!("no file for module {inner} in {}", folder.display()));
                parse(&file).items
            }
        };
        collect(items, inner, below, public, out);
    }
    out.push(Module { path, public, items: own });
}

fn is_public(vis: &syn::Visibility) -> bool {
    matches!(vis, syn::Visibility::Public(_))
}

/// Looks for foreign names in whatever it is shown.
struct Finder<'a> {
    names: &'a Names,
    /// Crate and the path as written.
    found: BTreeSet<(String, String)>,
}

impl<'ast> Visit<'ast> for Finder<'_> {
    fn visit_path(&mut self, path: &'ast syn::Path) {
        let words: Vec<String> = path.segments.iter().map(|s| plain(&s.ident)).collect();
        if let Some(foreign) = self.names.get(&words[0]) {
            self.found.insert((foreign.clone(), words.join("::")));
        }
        visit::visit_path(self, path);
    }

    // Bodies, values and attributes are nobody's business outside.
    fn visit_block(&mut self, _: &'ast syn::Block) {}
    fn visit_expr(&mut self, _: &'ast syn::Expr) {}
    fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}
}

/// What `show` lets a finder see, as (crate, path as written).
fn foreign_in(names: &Names, show: impl FnOnce(&mut Finder<'_>)) -> BTreeSet<(String, String)> {
    let mut finder = Finder { names, found: BTreeSet::new() };
    show(&mut finder);
    finder.found
}

/// Every foreign name in what can be reached of these modules: "module::item shows path".
fn shown(modules: &[Module], foreign: &BTreeSet<String>) -> Vec<(String, String)> {
    // Names that a `pub use` brings out of private modules.
    let mut exported = BTreeSet::new();
    let mut globs = BTreeSet::new();
    for item in modules.iter().flat_map(|m| &m.items) {
        if let syn::Item::Use(u) = item
            && is_public(&u.vis)
        {
            let mut found = Vec::new();
            leaves(&u.tree, &[], &mut found);
            for (name, path) in found {
                match (name.as_str(), path.last()) {
                    ("*", Some(module)) => drop(globs.insert(module.clone())),
                    (_, Some(original)) => drop(exported.insert(original.clone())),
                    _ => {}
                }
            }
        }
    }
    let mut out = Vec::new();
    for module in modules {
        let names = names_of(&module.items, foreign);
        let open = module.public || module.path.rsplit("::").next().is_some_and(|last| globs.contains(last));
        let reached = |name: &str| open || exported.contains(name);
        for item in &module.items {
            for (place, crates) in public_parts(item, &names, &reached) {
                let place = if module.path.is_empty() { place } else { format!("{}::{place}", module.path) };
                out.extend(crates.into_iter().map(|(owner, path)| (owner, format!("{place} shows {path}"))));
            }
        }
    }
    out
}

/// The names of dependencies in a file: themselves, what is imported from them, and aliases of that; our own names of the same
/// spelling win.
fn names_of(items: &[syn::Item], foreign: &BTreeSet<String>) -> Names {
    let mut names: Names = foreign.iter().map(|f| (f.clone(), f.clone())).collect();
    let mut found = Vec::new();
    for item in items {
        if let syn::Item::Use(u) = item {
            leaves(&u.tree, &[], &mut found);
        }
    }
    for (name, path) in found {
        match path.first().and_then(|p| foreign.get(p)) {
            Some(owner) => drop(names.insert(name, owner.clone())),
            None => drop(names.remove(&name)),
        }
    }
    for item in items {
        if let syn::Item::Type(alias) = item
            && let Some((owner, _)) = foreign_in(&names, |f| f.visit_type(&alias.ty)).into_iter().next()
        {
            names.insert(plain(&alias.ident), owner);
        }
    }
    names
}

/// The public parts of an item and the foreign names in each.
fn public_parts(
    item: &syn::Item,
    names: &Names,
    reached: &dyn Fn(&str) -> bool,
) -> Vec<(String, BTreeSet<(String, String)>)> {
    let counts = |vis: &syn::Visibility, ident: &syn::Ident| is_public(vis) && reached(&plain(ident));
    let one = |ident: &syn::Ident, show: &dyn Fn(&mut Finder<'_>)| vec![(plain(ident), foreign_in(names, |f| show(f)))];
    match item {
        syn::Item::Fn(x) if counts(&x.vis, &x.sig.ident) => one(&x.sig.ident, &|f| f.visit_signature(&x.sig)),
        syn::Item::Type(x) if counts(&x.vis, &x.ident) => one(&x.ident, &|f| f.visit_item_type(x)),
        syn::Item::Const(x) if counts(&x.vis, &x.ident) => one(&x.ident, &|f| f.visit_type(&x.ty)),
        syn::Item::Static(x) if counts(&x.vis, &x.ident) => one(&x.ident, &|f| f.visit_type(&x.ty)),
        syn::Item::Enum(x) if counts(&x.vis, &x.ident) => one(&x.ident, &|f| f.visit_item_enum(x)),
        syn::Item::Trait(x) if counts(&x.vis, &x.ident) => one(&x.ident, &|f| f.visit_item_trait(x)),
        syn::Item::Struct(x) if counts(&x.vis, &x.ident) => one(&x.ident, &|f| {
            f.visit_generics(&x.generics);
            x.fields.iter().filter(|field| is_public(&field.vis)).for_each(|field| f.visit_field(field));
        }),
        syn::Item::Use(x) if is_public(&x.vis) => {
            let mut found = Vec::new();
            leaves(&x.tree, &[], &mut found);
            let owned =
                |path: &[String]| path.first().and_then(|p| names.get(p)).map(|owner| (owner.clone(), path.join("::")));
            vec![("pub use".into(), found.iter().filter_map(|(_, path)| owned(path)).collect())]
        }
        syn::Item::Impl(x) => implementation(x, names, reached),
        _ => Vec::new(),
    }
}

/// Of an `impl`: the trait and its associated types, or the public methods.
fn implementation(
    x: &syn::ItemImpl,
    names: &Names,
    reached: &dyn Fn(&str) -> bool,
) -> Vec<(String, BTreeSet<(String, String)>)> {
    let syn::Type::Path(of) = &*x.self_ty else { return Vec::new() };
    let Some(name) = of.path.segments.last().map(|s| plain(&s.ident)) else { return Vec::new() };
    if !reached(&name) {
        return Vec::new();
    }
    let mut out = vec![(
        name.clone(),
        foreign_in(names, |f| {
            f.visit_generics(&x.generics);
            if let Some((path, _)) = &x.trait_ {
                f.visit_path(path);
            }
        }),
    )];
    for part in &x.items {
        match part {
            syn::ImplItem::Fn(f) if is_public(&f.vis) => {
                out.push((format!("{name}::{}", f.sig.ident), foreign_in(names, |v| v.visit_signature(&f.sig))));
            }
            syn::ImplItem::Const(c) if is_public(&c.vis) => {
                out.push((format!("{name}::{}", c.ident), foreign_in(names, |v| v.visit_type(&c.ty))));
            }
            syn::ImplItem::Type(t) if x.trait_.is_some() => {
                out.push((format!("{name}::{}", t.ident), foreign_in(names, |v| v.visit_type(&t.ty))));
            }
            _ => {}
        }
    }
    out
}

/// The dependencies of a manifest, of all targets, as code spells them; not those of this workspace.
fn dependencies(manifest: &toml::Table) -> BTreeSet<String> {
    let mut tables: Vec<&toml::Table> =
        manifest.get("dependencies").and_then(toml::Value::as_table).into_iter().collect();
    let targets = manifest.get("target").and_then(toml::Value::as_table);
    tables.extend(targets.into_iter().flat_map(|t| t.values()).filter_map(|t| t.get("dependencies")?.as_table()));
    tables.into_iter().flat_map(|t| t.keys()).filter(|k| !k.starts_with("drex-")).map(|k| k.replace('-', "_")).collect()
}

#[test]
fn public_interfaces_show_only_std_nalgebra_serde_and_our_own() {
    let mut wrong = Vec::new();
    let mut unused: BTreeSet<_> = HERE.iter().map(|(of, owner, _)| (*of, *owner)).collect();
    let mut crates = 0;
    for entry in std::fs::read_dir(workspace_root().join("crates")).unwrap() {
        let folder = entry.unwrap().path();
        let manifest: toml::Table = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap().parse().unwrap();
        let name = folder.file_name().unwrap().to_str().unwrap();
        let mut foreign = dependencies(&manifest);
        foreign.retain(|f| !EVERYWHERE.contains(&f.as_str()));
        let modules = modules(&folder.join("src"));
        assert!(modules.len() > 3 && modules.iter().any(|m| !m.items.is_empty()), "{name}: nothing was read");
        for (owner, place) in shown(&modules, &foreign) {
            if let Some(known) = HERE.iter().find(|(of, crate_, _)| *of == name && *crate_ == owner) {
                unused.remove(&(known.0, known.1));
            } else {
                wrong.push(format!("{name}: {place}"));
            }
        }
        crates += 1;
    }
    assert!(crates >= 11, "only {crates} crates were read");
    assert!(wrong.is_empty(), "other crates' types in public interfaces (box or wrap them):\n{}", wrong.join("\n"));
    assert!(unused.is_empty(), "exceptions that are no longer needed: {unused:?}");
}

/// What the search finds in one file, as crate names, in order.
fn found_in(source: &str) -> Vec<String> {
    let foreign = ["image", "csv", "zip"].map(String::from).into();
    let mut modules = Vec::new();
    collect(syn::parse_file(source).unwrap().items, String::new(), PathBuf::new(), true, &mut modules);
    let mut found: Vec<String> = shown(&modules, &foreign).into_iter().map(|(owner, _)| owner).collect();
    found.sort();
    found.dedup();
    found
}

#[test]
fn foreign_types_are_found_wherever_they_show() {
    for shows in [
        "pub enum Error { Picture { source: image::ImageError } }",
        "use image::ImageError as Why; pub struct Failure { pub why: Vec<Why> }",
        "pub fn read() -> Result<(), image::ImageError> { todo!() }",
        "pub fn of<T: image::GenericImage>(_: &T) {}",
        "pub fn of<T>(_: &T) where T: image::GenericImage {}",
        "type Inner = image::DynamicImage; pub fn picture() -> Inner { todo!() }",
        "pub struct A; impl From<image::ImageError> for A { fn from(_: image::ImageError) -> A { A } }",
        "pub struct A; impl A { pub fn get(&self) -> &image::DynamicImage { todo!() } }",
        "pub struct A; impl Iterator for A { type Item = image::Rgb; fn next(&mut self) -> Option<image::Rgb> { None } }",
        "pub trait Draws { fn draw(&self) -> image::DynamicImage; }",
        "pub mod inner { pub static LAST: Option<image::ImageError> = None; }",
        "pub use image::DynamicImage;",
        "mod inner { pub struct A { pub p: image::DynamicImage } } pub use inner::A;",
        "mod inner { pub struct A { pub p: image::DynamicImage } } pub use inner::*;",
    ] {
        assert_eq!(found_in(shows), ["image"], "{shows}");
    }
}

#[test]
fn what_stays_inside_is_left_alone() {
    for hides in [
        "pub enum Error { Picture { source: Box<dyn std::error::Error> } }",
        "pub struct A { p: image::DynamicImage, pub n: usize }",
        "pub(crate) fn read() -> image::DynamicImage { todo!() }",
        "pub fn read() -> usize { let p: image::DynamicImage = todo!(); p.width() }",
        "mod inner { pub struct A { pub p: image::DynamicImage } }",
        "mod inner { pub fn read() -> image::DynamicImage { todo!() } } pub use inner::other;",
        "pub struct A; impl A { fn get(&self) -> image::DynamicImage { todo!() } }",
        "#[cfg(test)] pub mod tests { pub fn read() -> image::DynamicImage { todo!() } }",
        "use crate::io::csv; pub fn table() -> csv::Table { todo!() }",
    ] {
        assert_eq!(found_in(hides), [""; 0], "{hides}");
    }
}
