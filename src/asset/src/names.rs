//! What the names of nodes and meshes say.

/// The words of a name in a file: parted at capitals, digits and marks, in small letters.
pub fn name_words(name: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut last = ' ';
    for c in name.chars() {
        let begins = !last.is_alphanumeric()
            || c.is_uppercase() && last.is_lowercase()
            || c.is_ascii_digit() != last.is_ascii_digit();
        if c.is_alphanumeric() {
            match words.last_mut() {
                Some(word) if !begins => word.extend(c.to_lowercase()),
                _ => words.push(c.to_lowercase().collect()),
            }
        }
        last = c;
    }
    words
}

/// Whether a mesh is for programs and not for the eye, by its name: a coarser level of detail, or a hull for collisions.
pub fn is_hidden(name: &str) -> bool {
    let words = name_words(name);
    let is_hull = |word: &String| {
        matches!(
            word.as_str(),
            "hull" | "hulls" | "collision" | "collisions" | "collider" | "colliders" | "ucx" | "ubx" | "usp"
        )
    };
    let is_level = |pair: &[String]| pair[0] == "lod" && pair[1].parse::<u32>().is_ok_and(|level| level > 0);
    words.iter().any(is_hull) || words.windows(2).any(is_level)
}
