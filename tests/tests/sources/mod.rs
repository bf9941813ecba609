//! Reads our own Rust sources: what the tests of the sources share.
#![allow(dead_code)] // each test uses a part

use std::path::{Path, PathBuf};

use syn::punctuated::Punctuated;

/// An identifier without the `r#` of a keyword.
pub fn plain(ident: &syn::Ident) -> String {
    ident.to_string().trim_start_matches("r#").to_owned()
}

/// `#[cfg(test)]`, `#[cfg(all(test, …))]`, `#[cfg(doctest)]` and `#[test]`.
pub fn is_test(attributes: &[syn::Attribute]) -> bool {
    let only_tests = |condition: &syn::Meta| {
        let is = |m: &syn::Meta| m.path().is_ident("test") || m.path().is_ident("doctest");
        is(condition)
            || matches!(condition, syn::Meta::List(list) if list.path.is_ident("all")
                && list.parse_args_with(Punctuated::<syn::Meta, syn::Token![,]>::parse_terminated)
                    .is_ok_and(|all| all.iter().any(is)))
    };
    attributes.iter().any(|a| {
        a.path().is_ident("test")
            || a.path().is_ident("cfg") && a.parse_args::<syn::Meta>().is_ok_and(|condition| only_tests(&condition))
    })
}

/// The leaves of a `use`: the name it gives and the path it leads to; a glob gives `*`.
pub fn leaves(tree: &syn::UseTree, before: &[String], out: &mut Vec<(String, Vec<String>)>) {
    let with = |ident: &syn::Ident| before.iter().cloned().chain([plain(ident)]).collect::<Vec<_>>();
    match tree {
        syn::UseTree::Path(p) => leaves(&p.tree, &with(&p.ident), out),
        syn::UseTree::Name(n) if n.ident == "self" => {
            out.push((before.last().cloned().unwrap_or_default(), before.to_vec()));
        }
        syn::UseTree::Name(n) => out.push((plain(&n.ident), with(&n.ident))),
        syn::UseTree::Rename(r) => out.push((plain(&r.rename), with(&r.ident))),
        syn::UseTree::Glob(_) => out.push(("*".into(), before.to_vec())),
        syn::UseTree::Group(g) => g.items.iter().for_each(|t| leaves(t, before, out)),
    }
}

/// A package of the repository.
pub struct Package {
    /// Its name in its manifest.
    pub name: String,
    /// Its folder of sources.
    pub src: PathBuf,
}

/// The packages in these folders of the repository, in order of their names.
pub fn packages(folders: &[&str]) -> Vec<Package> {
    let mut out = Vec::new();
    for folder in folders {
        for entry in std::fs::read_dir(drex_tests::workspace_root().join(folder)).unwrap() {
            let at = entry.unwrap().path();
            let Ok(manifest) = std::fs::read_to_string(at.join("Cargo.toml")) else { continue };
            let manifest: toml::Table = manifest.parse().unwrap();
            let name = manifest["package"]["name"].as_str().unwrap().to_owned();
            out.push(Package { name, src: at.join("src") });
        }
    }
    out.sort_by(|a, b| a.name.cmp(&b.name));
    out
}

/// The Rust files below a folder, in order of their paths.
pub fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut out = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            out.extend(rust_files(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
    out.sort();
    out
}

/// A source file as it was parsed.
pub fn parse(file: &Path) -> syn::File {
    let text = std::fs::read_to_string(file).unwrap();
    syn::parse_file(&text).unwrap_or_else(|e| panic!("{}: {e}", file.display()))
}
