//! The words of the field: no source defines an identifier that `tests/vocabulary.toml` says is gone.
//!
//! Every Rust file of the crates, apps and bindings is parsed; definitions count (types, traits, functions, methods, fields, variants,
//! constants, modules, macros), local variables and arguments do not, nor does what only tests have.
#![allow(clippy::unwrap_used, missing_docs)] // a failed unwrap is a failed test

mod sources;

use std::collections::BTreeSet;

use serde::Deserialize;
use sources::{is_test, packages, parse, plain, rust_files};
use syn::visit::{self, Visit};

/// `tests/vocabulary.toml`; the comment at its head says what each table means.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Vocabulary {
    #[serde(default)]
    word: Vec<Word>,
    #[serde(default)]
    renamed: Vec<Renamed>,
    #[serde(default)]
    exception: Vec<Exception>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Word {
    old: String,
    new: String,
    #[serde(default)]
    pending: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Renamed {
    #[serde(rename = "crate")]
    package: String,
    old: String,
    new: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Exception {
    #[serde(rename = "crate")]
    package: String,
    identifier: String,
    reason: String,
}

/// One defined name.
#[derive(Debug, Clone)]
struct Definition {
    package: String,
    /// File and line.
    place: String,
    name: String,
    /// The type, trait or module that it is defined in.
    owner: String,
    /// A type or function that is `pub` (also within its crate only), or a method of a public trait.
    is_public: bool,
}

impl Definition {
    /// Whether `pattern`, a name or `Owner::name`, means this definition.
    fn is(&self, pattern: &str) -> bool {
        match pattern.rsplit_once("::") {
            Some((owner, name)) => self.name == name && self.owner == owner,
            None => self.name == pattern,
        }
    }
}

/// Collects the definitions of one file.
struct Collector<'a> {
    package: &'a str,
    file: &'a str,
    owners: Vec<String>,
    found: Vec<Definition>,
}

impl Collector<'_> {
    fn add(&mut self, ident: &syn::Ident, is_public: bool) {
        self.found.push(Definition {
            package: self.package.to_owned(),
            place: format!("{}:{}", self.file, ident.span().start().line),
            name: plain(ident),
            owner: self.owners.last().cloned().unwrap_or_default(),
            is_public,
        });
    }

    fn within(&mut self, owner: String, visit: impl FnOnce(&mut Self)) {
        self.owners.push(owner);
        visit(self);
        self.owners.pop();
    }
}

fn is_public(vis: &syn::Visibility) -> bool {
    !matches!(vis, syn::Visibility::Inherited)
}

impl<'ast> Visit<'ast> for Collector<'_> {
    fn visit_item(&mut self, item: &'ast syn::Item) {
        use syn::Item;
        let attributes = match item {
            Item::Fn(x) => &x.attrs,
            Item::Mod(x) => &x.attrs,
            Item::Impl(x) => &x.attrs,
            _ => &Vec::new(),
        };
        if is_test(attributes) {
            return;
        }
        match item {
            Item::Struct(x) => self.add(&x.ident, is_public(&x.vis)),
            Item::Enum(x) => self.add(&x.ident, is_public(&x.vis)),
            Item::Trait(x) => self.add(&x.ident, is_public(&x.vis)),
            Item::Type(x) => self.add(&x.ident, is_public(&x.vis)),
            Item::Fn(x) => self.add(&x.sig.ident, is_public(&x.vis)),
            Item::Const(x) => self.add(&x.ident, false),
            Item::Static(x) => self.add(&x.ident, false),
            Item::Mod(x) => self.add(&x.ident, false),
            Item::Macro(x) => x.ident.iter().for_each(|i| self.add(i, false)),
            _ => {}
        }
        let owner = match item {
            Item::Struct(x) => plain(&x.ident),
            Item::Enum(x) => plain(&x.ident),
            Item::Trait(x) => plain(&x.ident),
            Item::Mod(x) => plain(&x.ident),
            Item::Impl(x) => match &*x.self_ty {
                syn::Type::Path(of) => of.path.segments.last().map(|s| plain(&s.ident)).unwrap_or_default(),
                _ => String::new(),
            },
            _ => self.owners.last().cloned().unwrap_or_default(),
        };
        self.within(owner, |c| visit::visit_item(c, item));
    }

    fn visit_field(&mut self, field: &'ast syn::Field) {
        field.ident.iter().for_each(|i| self.add(i, false));
    }

    fn visit_variant(&mut self, variant: &'ast syn::Variant) {
        self.add(&variant.ident, false);
        visit::visit_variant(self, variant);
    }

    fn visit_impl_item_fn(&mut self, f: &'ast syn::ImplItemFn) {
        if is_test(&f.attrs) {
            return;
        }
        self.add(&f.sig.ident, is_public(&f.vis));
        visit::visit_impl_item_fn(self, f);
    }

    fn visit_impl_item_const(&mut self, c: &'ast syn::ImplItemConst) {
        self.add(&c.ident, false);
    }

    fn visit_trait_item_fn(&mut self, f: &'ast syn::TraitItemFn) {
        self.add(&f.sig.ident, true);
        visit::visit_trait_item_fn(self, f);
    }
}

/// What a source file defines.
fn definitions(package: &str, file: &str, module: &str, source: &syn::File) -> Vec<Definition> {
    let mut collector = Collector { package, file, owners: vec![module.to_owned()], found: Vec::new() };
    collector.visit_file(source);
    collector.found
}

/// What all packages define.
fn all_definitions() -> Vec<Definition> {
    let mut out = Vec::new();
    for package in packages(&["crates", "apps", "bindings"]) {
        for file in rust_files(&package.src) {
            let named = if file.file_stem().unwrap() == "mod" { file.parent().unwrap() } else { &*file };
            let module = named.file_stem().unwrap().to_str().unwrap();
            let shown = file.strip_prefix(drex_tests::workspace_root()).unwrap().display().to_string();
            out.extend(definitions(&package.name, &shown, module, &parse(&file)));
        }
    }
    out
}

/// The parts of a name in small letters: `MotorLook` and `motor_look` are motor, look.
fn parts(name: &str) -> Vec<String> {
    let mut out = vec![String::new()];
    let mut before = '_';
    for c in name.chars() {
        if c == '_' || c == ' ' || (c.is_uppercase() && !before.is_uppercase()) {
            out.push(String::new());
        }
        if c != '_' && c != ' ' {
            out.last_mut().unwrap().extend(c.to_lowercase());
        }
        before = c;
    }
    out.retain(|p| !p.is_empty());
    out
}

/// Whether a word, of one part or several, is the name of a definition, or of a public type or function a part.
fn has_word(definition: &Definition, word: &str) -> bool {
    let (name, word) = (parts(&definition.name), parts(word));
    name == word || (definition.is_public && name.windows(word.len()).any(|w| w == word))
}

/// Everything wrong with these definitions or with the list itself.
fn problems(list: &Vocabulary, definitions: &[Definition]) -> Vec<String> {
    let mut out = Vec::new();
    let packages: BTreeSet<&str> = definitions.iter().map(|d| d.package.as_str()).collect();
    let named = list.renamed.iter().map(|r| &r.package).chain(list.exception.iter().map(|e| &e.package));
    for package in named.chain(list.word.iter().flat_map(|w| &w.pending)) {
        if !packages.contains(package.as_str()) {
            out.push(format!(
                "vocabulary.toml names the crate {package}, which is not there: name the one that has its code"
            ));
        }
    }
    let except = |d: &Definition| list.exception.iter().any(|e| e.package == d.package && d.is(&e.identifier));
    for r in &list.renamed {
        if r.new.trim().is_empty() || r.new == r.old {
            out.push(format!("vocabulary.toml: {} of {} has no new name", r.old, r.package));
        }
        for d in definitions.iter().filter(|d| d.package == r.package && d.is(&r.old)) {
            out.push(format!("{}: `{}` is called `{}` now", d.place, r.old, r.new));
        }
    }
    for w in &list.word {
        let has = |d: &&Definition| has_word(d, &w.old) && !except(d);
        let (waiting, wrong): (Vec<_>, Vec<_>) =
            definitions.iter().filter(has).partition(|d| w.pending.contains(&d.package));
        out.extend(wrong.iter().map(|d| format!("{}: `{}` has the word `{}`; say {}", d.place, d.name, w.old, w.new)));
        for package in w.pending.iter().filter(|p| !waiting.iter().any(|d| d.package == **p)) {
            out.push(format!("vocabulary.toml: `{}` is gone from {package}: take it out of `pending`", w.old));
        }
    }
    for e in &list.exception {
        if e.reason.trim().is_empty() {
            out.push(format!("vocabulary.toml: the exception {} of {} has no reason", e.identifier, e.package));
        }
        if !definitions.iter().any(|d| d.package == e.package && d.is(&e.identifier)) {
            out.push(format!("vocabulary.toml: {} has no {} any more: drop the exception", e.package, e.identifier));
        }
    }
    out
}

#[test]
fn no_name_that_is_gone_is_defined_again() {
    let list = std::fs::read_to_string(drex_tests::workspace_root().join("tests/vocabulary.toml")).unwrap();
    let list: Vocabulary = toml::from_str(&list).unwrap();
    let definitions = all_definitions();
    assert!(definitions.len() > 5000, "only {} definitions were read", definitions.len());
    let problems = problems(&list, &definitions);
    assert!(problems.is_empty(), "{} words of tests/vocabulary.toml:\n{}", problems.len(), problems.join("\n"));
}

/// What the test finds in one source of a crate `drex-a`, which has a `Known` besides.
fn found(list: &str, source: &str) -> Vec<String> {
    let source = syn::parse_file(&format!("{source} struct Known;")).unwrap();
    let definitions = definitions("drex-a", "a.rs", "a", &source);
    problems(&toml::from_str(list).unwrap(), &definitions)
}

const LIFE: &str = "[[renamed]]\ncrate = 'drex-a'\nold = 'Life'\nnew = 'MotorState'\n";

#[test]
fn an_old_name_is_found_wherever_it_is_defined() {
    for source in ["struct Life;", "pub enum Life {}", "trait Life {}", "type Life = u8;", "mod b { enum A { Life } }"]
    {
        assert_eq!(found(LIFE, &format!("\n{source}")), ["a.rs:2: `Life` is called `MotorState` now"], "{source}");
    }
    let list = LIFE.replace("Life", "life");
    for source in [
        "fn life() {}",
        "mod life {}",
        "struct A { life: u8 }",
        "struct A; impl A { fn life() {} }",
        "trait A { fn life(); }",
        "enum A { B { life: u8 } }",
        "fn a() { fn life() {} }",
        "macro_rules! life { () => {} }",
    ] {
        assert_eq!(found(&list, source).len(), 1, "{source}");
    }
    let owned = LIFE.replace("Life", "Lamp::life");
    assert_eq!(found(&owned, "struct Lamp { life: u8 } struct Cat { life: u8 }").len(), 1);
    assert_eq!(found(&owned, "struct Lamp; impl Lamp { fn life() {} } impl Cat { fn life() {} } struct Cat;").len(), 1);
}

#[test]
fn a_use_of_a_name_a_local_and_a_test_are_left_alone() {
    let list = LIFE.replace("Life", "life");
    for source in [
        "fn a(life: u8) -> u8 { let life = life; life }",
        "use other::life; fn a() {}",
        "#[cfg(test)] mod tests { fn life() {} }",
        "#[test] fn life() {}",
        "struct Life; fn lifelong() {}",
    ] {
        assert_eq!(found(&list, source), [""; 0], "{source}");
    }
}

#[test]
fn a_word_is_found_as_a_name_and_as_a_part_of_a_public_one() {
    let list = "[[word]]\nold = 'made up'\nnew = 'unobserved'\n";
    for source in [
        "struct MadeUp;",
        "fn made_up() {}",
        "pub fn is_made_up() {}",
        "pub struct ShareMadeUp;",
        "const MADE_UP: u8 = 0;",
    ] {
        assert_eq!(found(list, source).len(), 1, "{source}");
    }
    for source in ["fn is_made_up() {}", "pub struct Made;", "pub fn up_made() {}"] {
        assert_eq!(found(list, source), [""; 0], "{source}");
    }
}

#[test]
fn exceptions_and_pending_crates_hold_only_while_they_are_needed() {
    let word = "[[word]]\nold = 'limp'\nnew = 'torque off'\n";
    let pending = format!("{word}pending = ['drex-a']\n");
    let except = format!("{word}[[exception]]\ncrate = 'drex-a'\nidentifier = 'limp'\nreason = 'a field of a file'\n");
    for list in [&pending, &except] {
        assert_eq!(found(list, "struct A { limp: bool }"), [""; 0], "{list}");
        assert_eq!(found(list, "struct A { torque_off: bool }").len(), 1, "{list}");
    }
    assert_eq!(found(&except.replace("a field of a file", ""), "struct A { limp: bool }").len(), 1);
    assert_eq!(found(&except.replace("drex-a", "drex-b"), "struct A;").len(), 2);
    assert_eq!(found(&LIFE.replace("MotorState", "Life"), "struct A;").len(), 1);
}
