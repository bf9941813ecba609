//! What names of links and joints say.

use drex_demo::HumanFinger;
use drex_robot::Robot;

/// Words for the fingers. A long word may be the beginning of a longer one (`ringfinger`), a short one stands alone, perhaps
/// followed by `j` for joint (`FFJ3`).
const WORDS: [(HumanFinger, &[&str], &[&str]); 5] = [
    (HumanFinger::Thumb, &["thumb"], &["th"]),
    (HumanFinger::Index, &["index", "forefinger", "pointer"], &["if", "ff"]),
    (HumanFinger::Middle, &["middle"], &["mf", "mid"]),
    (HumanFinger::Ring, &["ring"], &["rf"]),
    (HumanFinger::Little, &["little", "pinky", "pinkie"], &["lf"]),
];

/// The finger that the names of these links and joints speak of, if most of them that speak of any agree.
pub(super) fn finger(robot: &Robot, links: &[usize], joints: &[usize]) -> Option<HumanFinger> {
    let names = links.iter().map(|&l| &robot.links[l].name).chain(joints.iter().map(|&j| &robot.joints[j].name));
    let mut votes = [0_usize; 5];
    for found in names.filter_map(|name| finger_of(name)) {
        votes[found as usize] += 1;
    }
    let most = *votes.iter().max()?;
    let mut best = HumanFinger::ALL.into_iter().filter(|f| most > 0 && votes[*f as usize] == most);
    best.next().filter(|_| best.next().is_none())
}

/// The first finger that a name speaks of: `index_middle_phalanx` is of the index finger.
fn finger_of(name: &str) -> Option<HumanFinger> {
    words(name).iter().find_map(|word| {
        let short = word.strip_suffix('j').unwrap_or(word);
        WORDS
            .iter()
            .find(|(_, long, abbreviations)| {
                long.iter().any(|l| word.starts_with(l)) || abbreviations.iter().any(|a| *a == word || *a == short)
            })
            .map(|(finger, ..)| *finger)
    })
}

/// Whether `word` is one of the words of `name`.
pub(super) fn has_word(name: &str, word: &str) -> bool {
    words(name).iter().any(|w| w == word)
}

/// Lower-case words of a name: `rh_FFJ3` is rh, ffj; `IndexDistal` is index, distal.
fn words(name: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut last = ' ';
    for c in name.chars() {
        if c.is_ascii_alphabetic() {
            if !last.is_ascii_alphabetic() || (last.is_ascii_lowercase() && c.is_ascii_uppercase()) {
                words.push(String::new());
            }
            if let Some(word) = words.last_mut() {
                word.push(c.to_ascii_lowercase());
            }
        }
        last = c;
    }
    words
}

/// The name most like `name`, if any is like it at all.
pub(super) fn most_similar<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    let (distance, nearest) = known.iter().map(|candidate| (edits(name, candidate), *candidate)).min()?;
    (2 * distance <= name.chars().count().max(nearest.chars().count())).then_some(nearest)
}

/// Levenshtein's distance, upper and lower case alike.
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.to_lowercase().chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.to_lowercase().chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_vendors() {
        for (name, finger) in [
            ("rh_FFJ3", Some(HumanFinger::Index)),
            ("if_mcp", Some(HumanFinger::Index)),
            ("index_middle_phalanx", Some(HumanFinger::Index)),
            ("right_hand_Pinky", Some(HumanFinger::Little)),
            ("L_ring_proximal_joint", Some(HumanFinger::Ring)),
            ("thj0", Some(HumanFinger::Thumb)),
            ("LeftHandThumb1", Some(HumanFinger::Thumb)),
            ("thumb_mcp_middle", Some(HumanFinger::Thumb)),
            ("mf_tip", Some(HumanFinger::Middle)),
            ("joint_12.0", None),
            ("spring", None),
            ("palm_lower_left", None),
        ] {
            assert_eq!(finger_of(name), finger, "{name}");
        }
    }

    #[test]
    fn similar_names() {
        assert_eq!(most_similar("thumb_tip_hed", &["base", "thumb_tip_head", "thumb_dip"]), Some("thumb_tip_head"));
        assert_eq!(most_similar("Wrist", &["base", "wrist"]), Some("wrist"));
        assert_eq!(most_similar("xyz", &["palm", "thumb"]), None);
        assert_eq!(edits("kitten", "sitting"), 3);
    }
}
