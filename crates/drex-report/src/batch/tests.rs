//! Pages of batches whose rows are written by hand.

use std::f64::consts::TAU;

use drex_core::stats::normal_pair;
use drex_twin::batch::{Row, RunRecord};

use super::*;

/// A folder of twins with these names, each with a mesh, and a batch of it.
fn batch(names: &[&str]) -> (tempfile::TempDir, Batch) {
    let dir = tempfile::tempdir().unwrap();
    for name in names {
        let mesh = dir.path().join(name).join("mesh");
        std::fs::create_dir_all(&mesh).unwrap();
        std::fs::write(dir.path().join(name).join("twin.toml"), "").unwrap();
        std::fs::write(mesh.join("visual.obj"), cup()).unwrap();
    }
    let batch = Batch::open(dir.path(), None).unwrap();
    (dir, batch)
}

/// A bumpy cup of 3,000 triangles or so, which fills its picture with detail.
fn cup() -> String {
    const RINGS: usize = 24;
    const AROUND: usize = 64;
    let mut obj = String::new();
    for ring in 0..RINGS {
        for k in 0..AROUND {
            let (height, angle) = (ring as f64 / RINGS as f64, TAU * k as f64 / AROUND as f64);
            let radius = 0.04 + 0.004 * (7.0 * angle).sin() * (20.0 * height).cos() + 0.01 * height;
            obj += &format!("v {} {} {}\n", radius * angle.cos(), radius * angle.sin(), 0.1 * height);
        }
    }
    for ring in 0..RINGS - 1 {
        for k in 0..AROUND {
            let at = |ring: usize, k: usize| 1 + ring * AROUND + k % AROUND;
            obj += &format!("f {} {} {}\n", at(ring, k), at(ring, k + 1), at(ring + 1, k));
            obj += &format!("f {} {} {}\n", at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k));
        }
    }
    obj
}

/// The row of an item that is done, with nothing unusual.
fn done(name: &str) -> Row {
    Row {
        name: name.to_owned(),
        task: "twin".to_owned(),
        status: Status::Done,
        mass_kg: Some(0.2),
        mass_low_kg: Some(0.18),
        mass_high_kg: Some(0.22),
        mass_source: "identified".to_owned(),
        verdict: "identified".to_owned(),
        hand: "leap_right".to_owned(),
        friction: Some(0.5),
        proposed: Some(8),
        passed: Some(6),
        grip_force_n: Some(7.0),
        held: Some(22),
        trials: Some(24),
        success_rate: Some(22.0 / 24.0),
        success_low: Some(0.74),
        success_high: Some(0.98),
        seed: 1,
        program: "drex 0.1.0".to_owned(),
        error: String::new(),
    }
}

fn without_values(name: &str, status: Status, error: &str) -> Row {
    let (mass_kg, mass_low_kg, mass_high_kg, grip_force_n, held, trials) = (None, None, None, None, None, None);
    let (verdict, error) = (String::new(), error.to_owned());
    Row { status, mass_kg, mass_low_kg, mass_high_kg, verdict, grip_force_n, held, trials, error, ..done(name) }
}

/// A table in which every row that is not pending took half a minute.
fn table(rows: Vec<Row>) -> Table {
    let run = RunRecord {
        seconds: 30.0,
        core_seconds: Some(50.0),
        threads: 1,
        host: "lab-3".to_owned(),
        ..RunRecord::default()
    };
    let ran = rows.iter().filter(|r| r.status != Status::Pending).map(|r| (r.name.clone(), (1, run.clone()))).collect();
    Table::new(rows, ran)
}

fn names(count: usize) -> Vec<String> {
    (0..count).map(|i| format!("tin-{i:03}")).collect()
}

/// The page of these rows in a folder without meshes.
fn page_of(table: &Table) -> String {
    let (_dir, batch) = batch(&["tin-000"]);
    page(&batch, table)
}

/// The page between its style and its scripts, without its pictures.
fn body(html: &str) -> String {
    let body = html.split("<body>").nth(1).unwrap().split("<script>").next().unwrap();
    let mut parts = body.split("src=\"data:");
    let first = parts.next().unwrap().to_owned();
    parts.fold(first, |body, part| body + part.split_once('"').unwrap().1)
}

fn no_odd_numbers(html: &str) {
    let body = body(html);
    for word in ["NaN", "inf ", "inf\"", "inf<", ">-0 ", ">-0<"] {
        assert!(!body.contains(word), "{word} in {body}");
    }
}

#[test]
fn failures_come_before_all_else_and_every_item_has_a_card_with_its_numbers() {
    let (dir, batch) = batch(&["cup", "jar", "lid", "tin"]);
    std::fs::write(dir.path().join("cup/report.html"), "").unwrap();
    std::fs::remove_file(dir.path().join("tin/mesh/visual.obj")).unwrap();
    let rows = vec![
        done("cup"),
        without_values("jar", Status::Pending, ""),
        without_values("lid", Status::Failed, "lid/twin.toml, line 3: no mass & no push"),
        done("tin"),
    ];
    let path = write_batch(&batch, &table(rows)).unwrap();
    assert_eq!(path, dir.path().join("batch/report.html"));
    let html = std::fs::read_to_string(path).unwrap();
    let place = |text: &str| html.find(text).unwrap_or_else(|| panic!("no {text}"));
    let reason = "lid/twin.toml, line 3: no mass &amp; no push";
    let order = ["2 of 4", ">Failures</h2>", reason, ">Outliers</h2>", ">Distributions</h2>", ">All items</h2>"];
    assert!(order.windows(2).all(|w| place(w[0]) < place(w[1])), "{order:?}");
    // Failures first, then by name.
    let cards = ["id=\"i2\"", "id=\"i0\"", "id=\"i1\"", "id=\"i3\""];
    assert!(cards.windows(2).all(|w| place(w[0]) < place(w[1])));
    assert!(html.contains("<a class=\"name\" href=\"../cup/report.html\">cup</a>"));
    assert!(html.contains("<span class=\"name\">tin</span>"));
    assert_eq!((html.matches("src=\"data:image/jpeg").count(), html.matches(">no picture<").count()), (3, 1));
    assert!(html.contains("<dt>mass</dt><dd>200 g <small>180 to 220 g</small>"));
    assert!(html.contains("<dt>grip</dt><dd>7.00 N <small>3.57 × weight</small>"));
    assert!(html.contains("<dt>held</dt><dd>22 of 24 <small>74 to 98 %</small>"));
    assert!(html.contains("44 of 48") && html.contains("150</b><span>core-seconds"));
    assert!(html.contains("default-src 'none'"));
    assert!(!html.contains(dir.path().to_str().unwrap()), "a path of this machine");
    for word in ["http://", "https://", "src=\"/", "href=\"/", "url(", "@import"] {
        assert!(!html.contains(word), "{word}");
    }
    no_odd_numbers(&html);
}

#[cfg(unix)]
#[test]
fn hostile_names_and_reasons_stay_text() {
    let hostile =
        ["<script>alert(1)<", "a\" onload=\"alert(2)", "javascript:alert(3)", "two\nlines", "per%cent'&#x27;"];
    let (dir, batch) = batch(&hostile);
    for name in hostile {
        std::fs::write(dir.path().join(name).join("report.html"), "").unwrap();
    }
    // The page lies beside the twins, so that links begin with their names.
    let batch = Batch::open(dir.path(), Some(dir.path())).map(|b| (batch, b)).unwrap().1;
    let failed = without_values("<script>alert(1)<", Status::Failed, "<img src=x onerror=alert(4)>");
    let rows = hostile[1..].iter().map(|name| done(name)).chain([failed]).collect();
    let html = page(&batch, &table(rows));
    assert!(!html.contains("<script>alert") && !html.contains("<img src=x") && !html.contains("\" onload"));
    assert!(!html.contains("href=\"javascript:"), "a link may not be a script");
    for link in ["%3Cscript%3Ealert%281%29%3C", "two%0Alines", "per%25cent%27%26%23x27%3B"] {
        assert!(html.contains(&format!("href=\"{link}/report.html\"")), "{link}");
    }
    assert_eq!(html.matches("<script>").count(), 1, "ours");
}

#[test]
fn few_failures_are_told_one_by_one_and_many_by_their_reasons() {
    let rows = |n: usize| names(n).into_iter().enumerate();
    let reason = |i: usize, name: &str| match i % 3 {
        0 => format!("{name}/scan/tin.obj: the mesh is empty"),
        1 => format!("cannot read {name}/push/force.csv"),
        _ => "out of memory".to_owned(),
    };
    let failed = |n| rows(n).map(|(i, name)| without_values(&name, Status::Failed, &reason(i, &name))).collect();
    let html = page_of(&table(failed(20)));
    assert!(html.contains("<td>tin-003/scan/tin.obj: the mesh is empty</td>"));
    let html = page_of(&table(failed(40)));
    assert!(html.contains("<td>14</td><td>NAME/scan/tin.obj: the mesh is empty</td>"));
    assert!(html.contains("<td>13</td><td>cannot read NAME/push/force.csv</td>"));
    let listed = html.split(">All items</h2>").next().unwrap();
    assert_eq!(listed.matches("<a href=\"#i").count(), 40, "every one is named");
    assert_eq!(without_name("a/b: a, data/a.csv, a", "a"), "NAME/b: NAME, data/a.csv, NAME");
}

#[test]
fn tables_without_values_make_pages() {
    let html = page_of(&table(Vec::new()));
    assert!(html.contains("The batch has no items.") && html.contains("No item failed."));
    no_odd_numbers(&html);
    let failed = names(9).iter().map(|n| without_values(n, Status::Failed, "no")).collect();
    let html = page_of(&table(failed));
    assert!(html.contains("0 of 9") && html.contains("No item has a value to draw."));
    no_odd_numbers(&html);
    let html = page_of(&table(vec![done("tin-000")]));
    assert!(html.contains("Too few items to tell"));
    assert_eq!(html.matches("<svg").count(), 5);
    no_odd_numbers(&html);
}

#[test]
fn equal_values_are_no_outliers_and_make_plots() {
    let html = page_of(&table(names(40).iter().map(|n| done(n)).collect()));
    assert!(html.contains("No item stands out in width of the mass interval"));
    assert_eq!(html.matches("<svg").count(), 5);
    assert!(!html.contains("no data"));
    no_odd_numbers(&html);
}

#[test]
fn odd_numbers_are_left_out() {
    let odd = [f64::NAN, f64::INFINITY, -1.0, 0.0, f64::MAX, f64::MIN_POSITIVE];
    let rows: Vec<Row> = names(36)
        .iter()
        .enumerate()
        .map(|(i, name)| {
            let (a, b) = (Some(odd[i % 6]), Some(odd[i / 6]));
            let (held, trials) = ([Some(30), Some(usize::MAX)][i % 2], [Some(24), Some(usize::MAX)][i % 2]);
            Row { mass_kg: a, mass_low_kg: b, mass_high_kg: a, grip_force_n: b, held, trials, ..done(name) }
        })
        .collect();
    let mut table = table(rows);
    for (i, (_, run)) in table.runs.values_mut().enumerate() {
        (run.seconds, run.core_seconds) = (odd[i % 6], Some(odd[i / 6]));
    }
    no_odd_numbers(&page_of(&table));
}

#[test]
fn pictures_go_to_the_first_thousand() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("cup.obj"), cup()).unwrap();
    let masses: Vec<String> = (0..1010).map(|i| format!("{:.3}", 0.1 + 0.001 * f64::from(i))).collect();
    let list = format!(
        "schema = 1\n[[grasps]]\nmeshes = [\"cup.obj\"]\nhands = [\"leap_right\"]\nmasses_kg = [{}]\n",
        masses.join(", ")
    );
    std::fs::write(dir.path().join("list.toml"), list).unwrap();
    let batch = Batch::open(&dir.path().join("list.toml"), None).unwrap();
    let last = batch.items().len() - 1;
    let row = |(i, item): (usize, &drex_twin::batch::Item)| Row {
        task: "find".to_owned(),
        status: if i == last { Status::Failed } else { Status::Done },
        ..done(&item.name)
    };
    let html = page(&batch, &table(batch.items().iter().enumerate().map(row).collect()));
    assert_eq!(html.matches("src=\"data:image/jpeg").count(), gallery::MOST_PICTURES);
    assert!(html.contains("The first 1000 of 1010 items have pictures"));
    let failed = html.split(&format!("id=\"i{last}\"")).nth(1).unwrap();
    assert!(failed.split("</li>").next().unwrap().contains("data:image"), "failures have pictures first");
}

#[test]
fn a_hundred_thousand_failures_stay_small_and_no_link_leads_nowhere() {
    let rows = (0..100_000).map(|i| Row {
        status: Status::Failed,
        error: ["no mesh".to_owned(), format!("reason {}", i % 300)][i % 2].clone(),
        ..done(&format!("cup-{i:06}"))
    });
    let html = page_of(&table(rows.collect()));
    assert!(html.len() < 20_000_000, "{} bytes", html.len());
    assert_eq!(html.matches("<li class=\"card").count(), gallery::MOST_CARDS);
    assert!(html.contains("the first 10000 have cards"));
    assert!(html.contains(" and 49900 more") && html.contains("most frequent of 151 reasons"), "{}", &html[..3000]);
    let ids: BTreeSet<&str> = html.split(" id=\"i").skip(1).map(|s| s.split('"').next().unwrap()).collect();
    let links: Vec<&str> = html.split("href=\"#i").skip(1).map(|s| s.split('"').next().unwrap()).collect();
    assert!(links.len() > 100 && links.iter().all(|link| ids.contains(link)));
}

#[test]
fn three_hundred_items_stay_small_and_are_the_same_with_any_number_of_threads() {
    let names = names(300);
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let (_dir, batch) = batch(&names);
    let table = table(names.iter().map(|name| done(name)).collect());
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| page(&batch, &table))
    };
    let html = with(1);
    assert_eq!(html.matches("src=\"data:image/jpeg").count(), 300);
    assert!(html.len() < 6_000_000, "{} bytes", html.len());
    assert!(html == with(2), "threads change the page");
}

#[test]
fn the_page_of_a_batch_elsewhere_is_the_same() {
    let ((one, a), (other, b)) = (batch(&["cup", "tin"]), batch(&["cup", "tin"]));
    let rows = || table(vec![done("cup"), done("tin")]);
    assert_ne!(one.path(), other.path());
    assert!(page(&a, &rows()) == page(&b, &rows()));
}

#[test]
fn the_script_is_short() {
    assert!(include_str!("gallery.js").lines().count() < 40);
}

/// Uniform numbers in 0 to 1, 1 left out (splitmix64).
struct Uniform(u64);

impl Uniform {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let uniform = self.next();
        normal_pair(uniform, TAU * self.next())[0]
    }
}

/// A batch of like items: values whose logarithms are normal, trials that hold with the same probability.
fn like_items(count: usize, spread: f64, rate: f64, seed: u64) -> Table {
    let mut random = Uniform(seed);
    let rows = names(count).into_iter().map(|name| {
        let mass = 0.2 * (spread * random.normal()).exp();
        let half = 0.1 * mass * (spread * random.normal()).exp();
        let held = (0..24).filter(|_| random.next() < rate).count();
        Row {
            mass_kg: Some(mass),
            mass_low_kg: Some(mass - half.min(mass)),
            mass_high_kg: Some(mass + half.min(mass)),
            grip_force_n: Some(35.0 * mass * (spread * random.normal()).exp()),
            held: Some(held),
            ..done(&name)
        }
    });
    let mut table = table(rows.collect());
    for (_, run) in table.runs.values_mut() {
        run.seconds = 30.0 * (spread * random.normal()).exp();
    }
    table
}

#[test]
fn like_items_seldom_stand_out() {
    const BATCHES: usize = 400;
    for (count, rate) in [(40, 0.5), (40, 0.9), (40, 0.99), (40, 0.999), (8, 0.9), (300, 0.97)] {
        let alarms = (0..BATCHES).filter(|seed| {
            let table = like_items(count, [0.1, 0.4][seed % 2], rate, *seed as u64);
            !outliers::find(&Measured::all(&table)).found.is_empty()
        });
        let share = alarms.count() as f64 / BATCHES as f64;
        assert!(share < 0.05, "{share} of batches of {count} items at {rate}");
    }
}

#[test]
fn what_is_planted_stands_out_and_nothing_else() {
    let stands_out = |table: &Table| {
        let items = Measured::all(table);
        let found = outliers::find(&items).found;
        found.into_iter().map(|o| (items[o.row].row.name.clone(), o.quantity)).collect::<Vec<_>>()
    };
    let mut missed = 0;
    for seed in 0..20 {
        let mut table = like_items(40, 0.2, 0.9, seed);
        let row = &mut table.rows[3];
        (row.mass_low_kg, row.mass_high_kg) = (row.mass_kg.map(|m| 0.2 * m), row.mass_kg.map(|m| 2.0 * m));
        table.rows[11].grip_force_n = table.rows[11].grip_force_n.map(|n| 6.0 * n);
        table.rows[17].held = Some(9);
        table.runs.get_mut("tin-030").unwrap().1.seconds = 300.0;
        // One that went on where it was.
        table.runs.get_mut("tin-031").unwrap().1.seconds = 0.2;
        let expected = [
            ("tin-003".to_owned(), Quantity::MassInterval),
            ("tin-011".to_owned(), Quantity::Grip),
            ("tin-017".to_owned(), Quantity::SuccessRate),
            ("tin-030".to_owned(), Quantity::Seconds),
        ];
        missed += usize::from(stands_out(&table) != expected);
        if seed == 0 {
            let html = page_of(&table);
            let said = html.split(">Outliers</h2>").nth(1).unwrap().split("</table>").next().unwrap();
            for text in ["#i3\">tin-003<", "spreads above", "9 of 24 (95 %: ", "<td>5 min on lab-3, 1 thread</td>"] {
                assert!(said.contains(text), "{text} in {said}");
            }
        }
    }
    assert!(missed <= 1, "{missed} of 20");
}

#[test]
fn a_quantity_that_few_have_is_said_to_be_untold() {
    let mut rows: Vec<Row> = names(12).iter().map(|n| done(n)).collect();
    rows[5..].iter_mut().for_each(|row| (row.mass_low_kg, row.mass_high_kg) = (None, None));
    rows[0].mass_high_kg = Some(5.0);
    let html = page_of(&table(rows));
    assert!(html.contains("width of the mass interval: too few to tell, only 5 items"));
    assert!(html.contains("No item stands out in grip force per weight, success rate, seconds."));
}
