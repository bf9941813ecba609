//! The pages of the documentation: every page is in the book once, and every link within the repository leads to a file.
#![allow(clippy::unwrap_used, missing_docs)] // a failed unwrap is a failed test

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use drex_tests::workspace_root;

/// The markdown files under a folder, without those of builds and dependencies.
fn pages(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() && !path.is_symlink() && !name.starts_with('.') && !name.starts_with("target") {
            pages(&path, into);
        } else if name.ends_with(".md") {
            into.push(path);
        }
    }
}

/// The targets of `[text](target)` outside of code, without anchors and addresses of the web.
fn links(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut in_block = false;
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            in_block = !in_block;
        }
        if in_block || line.starts_with("    ") && !line.trim_start().starts_with('-') {
            continue;
        }
        // Every second part is inside of backticks.
        let plain: String = line.split('`').step_by(2).collect::<Vec<_>>().join("`");
        for rest in plain.split("](").skip(1) {
            let target = rest.split([')', '#', ' ']).next().unwrap();
            if !target.is_empty() && !target.contains("://") && !target.starts_with("mailto:") {
                found.push(target.to_owned());
            }
        }
    }
    found
}

#[test]
fn links_of_all_pages_lead_to_files() {
    let mut all = Vec::new();
    pages(&workspace_root(), &mut all);
    assert!(all.len() > 40, "{} pages", all.len());
    let mut wrong = Vec::new();
    for page in &all {
        let folder = page.parent().unwrap();
        for link in links(&fs::read_to_string(page).unwrap()) {
            if !folder.join(&link).exists() {
                wrong.push(format!("{}: {link}", page.strip_prefix(workspace_root()).unwrap().display()));
            }
        }
    }
    assert!(wrong.is_empty(), "links to nothing:\n{}", wrong.join("\n"));
}

#[test]
fn every_page_of_docs_is_in_the_book_once() {
    let docs = workspace_root().join("docs");
    let mut there = Vec::new();
    pages(&docs, &mut there);
    let there: BTreeSet<String> = there
        .iter()
        .map(|p| p.strip_prefix(&docs).unwrap().to_str().unwrap().replace('\\', "/"))
        .filter(|p| p != "SUMMARY.md")
        .collect();
    let summary = links(&fs::read_to_string(docs.join("SUMMARY.md")).unwrap().replace("  - ", "- "));
    let listed: BTreeSet<String> = summary.iter().cloned().collect();
    assert_eq!(listed.len(), summary.len(), "a page is in docs/SUMMARY.md twice");
    assert_eq!(there, listed);
}

#[test]
fn links_are_found_outside_of_code() {
    let text = "a [b](c.md#d) `[e](f.md)` [g](https://h.i)\n```\n[j](k.md)\n```\n- [l](m/n.md), ![o](p.png)\n";
    assert_eq!(links(text), ["c.md", "m/n.md", "p.png"]);
}
