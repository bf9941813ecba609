//! Licences and duplicate versions of everything that is built, against `deny.toml`.
#![allow(clippy::unwrap_used, missing_docs)] // a test: a panic is the report

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use drex_tests::workspace_root;
use serde::Deserialize;

#[derive(Deserialize)]
struct Deny {
    licenses: Licenses,
    bans: Bans,
}

#[derive(Deserialize)]
struct Licenses {
    allow: Vec<String>,
    exceptions: Vec<Exception>,
}

#[derive(Deserialize)]
struct Exception {
    #[serde(rename = "crate")]
    name: String,
    allow: Vec<String>,
}

#[derive(Deserialize)]
struct Bans {
    skip: Vec<Skip>,
}

#[derive(Deserialize)]
struct Skip {
    #[serde(rename = "crate")]
    spec: String,
    reason: String,
}

/// (name, version, licence expression) of a package.
type Packages = BTreeSet<(String, String, String)>;

/// Every package in the normal and build dependency graph of the workspace.
fn packages() -> Packages {
    // The features that bring in packages of their own; listing them needs no library.
    graph(&["--workspace", "--features", "drex-mujoco/engine,drex-core/wgpu"]).unwrap()
}

/// The same of a package in `bindings`, a workspace of its own; none if what it needs has not been fetched here.
fn packages_of(binding: &str) -> Packages {
    let manifest = format!("bindings/{binding}/Cargo.toml");
    graph(&["--manifest-path", &manifest]).unwrap_or_else(|reason| {
        assert!(!reason.contains("--locked"), "the Cargo.lock beside {manifest} is out of date: {reason}");
        eprintln!("skipped {manifest}, `cargo fetch` it first: {reason}");
        Packages::new()
    })
}

/// The packages that `cargo tree` lists with these arguments, from what is on this machine.
fn graph(arguments: &[&str]) -> Result<Packages, String> {
    let output = Command::new(env!("CARGO"))
        .arg("tree")
        .args(arguments)
        .args(["--locked", "--offline", "--edges", "normal,build", "--prefix", "none"])
        .args(["--format", "{p}|{l}"])
        .current_dir(workspace_root())
        .output()
        .unwrap();
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned());
    }
    Ok(String::from_utf8(output.stdout)
        .unwrap()
        .lines()
        .filter(|l| !l.trim().is_empty())
        .map(|line| {
            // A package that was listed before ends with a mark.
            let (package, license) = line.trim_end_matches(" (*)").split_once('|').unwrap();
            let mut words = package.split_whitespace();
            let (name, version) = (words.next().unwrap(), words.next().unwrap());
            (name.to_owned(), version.trim_start_matches('v').to_owned(), license.trim().to_owned())
        })
        .collect())
}

fn deny() -> Deny {
    toml::from_str(&std::fs::read_to_string(workspace_root().join("deny.toml")).unwrap()).unwrap()
}

/// Whether a licence expression can be satisfied with licences for which `allowed` holds.
/// AND binds tighter than OR; the old `A/B` spelling means OR.
fn satisfied(expression: &str, allowed: &dyn Fn(&str) -> bool) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let tokens: Vec<&str> = spaced.split_whitespace().collect();
    let mut at = 0;
    let ok = any_of(&tokens, &mut at, allowed);
    ok && at == tokens.len()
}

fn any_of(tokens: &[&str], at: &mut usize, allowed: &dyn Fn(&str) -> bool) -> bool {
    let mut ok = all_of(tokens, at, allowed);
    while tokens.get(*at) == Some(&"OR") {
        *at += 1;
        ok |= all_of(tokens, at, allowed);
    }
    ok
}

fn all_of(tokens: &[&str], at: &mut usize, allowed: &dyn Fn(&str) -> bool) -> bool {
    let mut ok = one(tokens, at, allowed);
    while tokens.get(*at) == Some(&"AND") {
        *at += 1;
        ok &= one(tokens, at, allowed);
    }
    ok
}

fn one(tokens: &[&str], at: &mut usize, allowed: &dyn Fn(&str) -> bool) -> bool {
    let Some(&token) = tokens.get(*at) else { return false };
    *at += 1;
    if token == "(" {
        let ok = any_of(tokens, at, allowed);
        *at += 1; // the closing parenthesis
        return ok;
    }
    if tokens.get(*at) == Some(&"WITH") {
        let full = format!("{token} WITH {}", tokens.get(*at + 1).unwrap_or(&""));
        *at += 2;
        return allowed(&full);
    }
    allowed(token)
}

#[test]
fn licence_expressions_are_understood() {
    let allowed = |l: &str| ["MIT", "Apache-2.0 WITH LLVM-exception", "Zlib"].contains(&l);
    assert!(satisfied("GPL-3.0 OR MIT", &allowed));
    assert!(satisfied("GPL-3.0/MIT", &allowed));
    assert!(satisfied("(GPL-3.0 OR MIT) AND Zlib", &allowed));
    assert!(satisfied("Apache-2.0 WITH LLVM-exception", &allowed));
    assert!(!satisfied("GPL-3.0 AND MIT", &allowed));
    assert!(!satisfied("GPL-3.0 OR Apache-2.0", &allowed));
    assert!(!satisfied("", &allowed));
}

#[test]
fn every_dependency_has_an_allowed_licence() {
    let deny = deny();
    let all = [packages(), packages_of("python"), packages_of("rerun")];
    let refused: Vec<String> = all
        .into_iter()
        .flatten()
        .collect::<Packages>()
        .into_iter()
        .filter(|(name, _, license)| {
            let excepted = deny.licenses.exceptions.iter().find(|e| e.name == *name);
            !satisfied(license, &|l| {
                deny.licenses.allow.iter().chain(excepted.iter().flat_map(|e| &e.allow)).any(|a| a == l)
            })
        })
        .map(|(name, version, license)| format!("{name} {version}: '{license}'"))
        .collect();
    assert!(refused.is_empty(), "not in deny.toml's licenses.allow:\n{}", refused.join("\n"));
}

#[test]
fn every_duplicate_version_has_a_reason() {
    let deny = deny();
    assert!(deny.bans.skip.iter().all(|s| !s.reason.is_empty()));
    let by_name = |packages: Packages| {
        let mut versions: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for (name, version, _) in packages {
            versions.entry(name).or_default().insert(version);
        }
        versions
    };
    // Not of bindings/rerun: which versions Rerun's crates agree on is theirs to say, and nothing else is built with them.
    let (versions, python) = (by_name(packages()), by_name(packages_of("python")));
    let skipped = |name: &str, version: &str| {
        deny.bans.skip.iter().any(|s| {
            s.spec.split_once('@').is_some_and(|(n, v)| {
                n == name && (version == v || version.strip_prefix(v).is_some_and(|rest| rest.starts_with('.')))
            })
        })
    };
    let unexplained: Vec<String> = versions
        .iter()
        .chain(&python)
        .filter(|(name, all)| all.iter().filter(|v| !skipped(name, v)).count() > 1)
        .map(|(name, all)| format!("{name}: {all:?}"))
        .collect();
    assert!(unexplained.is_empty(), "several versions without a reason in deny.toml:\n{}", unexplained.join("\n"));
    let stale: Vec<&str> = deny
        .bans
        .skip
        .iter()
        .filter(|s| {
            s.spec.split_once('@').is_none_or(|(name, _)| {
                versions.get(name).is_none_or(|all| all.len() < 2 || !all.iter().any(|v| skipped(name, v)))
            })
        })
        .map(|s| s.spec.as_str())
        .collect();
    assert!(stale.is_empty(), "deny.toml skips what is no duplicate any more: {stale:?}");
}
