//! Which file imports from which, names followed through re-exports to the file that defines them.

use super::modules::SourceFile;
use super::tokens::{Token, resolve_path, use_tree};
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

/// A crate's folder and the path of a module in it.
type ModuleKey = (String, Vec<String>);

/// What a module holds under which name.
#[derive(Default)]
struct ModuleNames {
    /// The file that it stands in.
    file: usize,
    /// What is defined in it.
    items: BTreeSet<String>,
    /// Names that a `use` brings, with their paths.
    aliases: BTreeMap<String, Vec<String>>,
    /// Modules of which everything is used.
    globs: Vec<Vec<String>>,
}

/// Where a path leads.
#[derive(Clone)]
enum PathTarget {
    Module(Vec<String>),
    /// An item that this file defines.
    ItemOf(usize),
}

/// A path that a file names in a module.
struct NamedPath {
    file: usize,
    module: Vec<String>,
    path: Vec<String>,
}

/// For each file, the files that it imports from. A re-export is not a import; tests are left out.
pub fn imported_files(files: &[SourceFile]) -> Vec<BTreeSet<usize>> {
    let mut names: BTreeMap<ModuleKey, ModuleNames> = BTreeMap::new();
    let mut named = Vec::new();
    for (k, file) in files.iter().enumerate() {
        read_names(k, file, &mut names, &mut named);
    }
    let mut imported = vec![BTreeSet::new(); files.len()];
    for NamedPath { file, module, path } in named {
        let lookup = Lookup {
            names: &names,
            crate_folder: &files[file].crate_folder,
        };
        if let Some(PathTarget::ItemOf(other)) = lookup.resolve(&module, &path, 0)
            && other != file
        {
            imported[file].insert(other);
        }
    }
    imported
}

/// Files that import each other, directly or over others: each group is one tangle.
pub fn circles(imported: &[BTreeSet<usize>]) -> Vec<Vec<usize>> {
    // Small enough for reachability from each file.
    let reached: Vec<BTreeSet<usize>> = (0..imported.len())
        .map(|start| {
            let (mut seen, mut open) = (BTreeSet::new(), vec![start]);
            while let Some(file) = open.pop() {
                open.extend(imported[file].iter().copied().filter(|&next| seen.insert(next)));
            }
            seen
        })
        .collect();
    let mut found = BTreeSet::new();
    for file in (0..imported.len()).filter(|&file| reached[file].contains(&file)) {
        found.insert(
            reached[file]
                .iter()
                .copied()
                .filter(|&other| reached[other].contains(&file))
                .collect::<Vec<_>>(),
        );
    }
    found.into_iter().collect()
}

/// The shortest way from a file back to itself.
pub fn shortest_circle(imported: &[BTreeSet<usize>], start: usize) -> Vec<usize> {
    let mut before: BTreeMap<usize, usize> = BTreeMap::new();
    let mut open = std::collections::VecDeque::from([start]);
    while let Some(file) = open.pop_front() {
        for &next in &imported[file] {
            if next == start {
                let mut way = vec![start, file];
                while *way.last().unwrap_or(&start) != start {
                    way.push(before[way.last().unwrap_or(&start)]);
                }
                way.reverse();
                return way;
            }
            if let Entry::Vacant(unseen) = before.entry(next) {
                unseen.insert(file);
                open.push_back(next);
            }
        }
    }
    Vec::new()
}

/// Notes what a file defines, uses and names.
fn read_names(k: usize, file: &SourceFile, names: &mut BTreeMap<ModuleKey, ModuleNames>, named: &mut Vec<NamedPath>) {
    let mut here = file.module.clone();
    // The ends of the inline modules that are open.
    let mut ends: Vec<usize> = Vec::new();
    let mut depth = 0;
    let module_of = |here: &[String]| (file.crate_folder.clone(), here.to_vec());
    names.entry(module_of(&here)).or_default().file = k;
    let mut i = 0;
    while i < file.tokens.len() {
        while ends.last().is_some_and(|&end| i >= end) {
            ends.pop();
            here.pop();
        }
        if file.test_only[i] {
            i += 1;
            continue;
        }
        let before_is_path = i >= 2 && file.is_sign(i - 1, ':') && file.is_sign(i - 2, ':');
        let continued = before_is_path && i >= 3 && (file.word(i - 3).is_some() || file.is_sign(i - 3, '>'));
        let member = i >= 1 && file.is_sign(i - 1, '.') && !(i >= 2 && file.is_sign(i - 2, '.'));
        match file.word(i) {
            Some("mod") if file.is_sign(i + 2, '{') => {
                ends.push(file.after_bracket(i + 2) - 1);
                here.extend(file.word(i + 1).map(str::to_owned));
                names.entry(module_of(&here)).or_default().file = k;
                i += 3;
                continue;
            }
            Some("use") => {
                let exported = i >= 1 && (file.word(i - 1) == Some("pub") || file.is_sign(i - 1, ')'));
                let end = (i..file.tokens.len())
                    .find(|&e| file.is_sign(e, ';'))
                    .unwrap_or(file.tokens.len());
                for (path, alias) in use_tree(&file.tokens[i + 1..end]) {
                    let path = resolve_path(path, &here);
                    let module = names.entry(module_of(&here)).or_default();
                    match alias.as_str() {
                        "*" => module.globs.push(path),
                        _ => {
                            if !exported {
                                named.push(NamedPath {
                                    file: k,
                                    module: here.clone(),
                                    path: path.clone(),
                                });
                            }
                            module.aliases.insert(alias, path);
                        }
                    }
                }
                i = end + 1;
                continue;
            }
            Some("struct" | "enum" | "union" | "trait" | "type" | "fn" | "const" | "static") if depth == ends.len() => {
                let name = if file.word(i + 1) == Some("mut") {
                    file.word(i + 2)
                } else {
                    file.word(i + 1)
                };
                names
                    .entry(module_of(&here))
                    .or_default()
                    .items
                    .extend(name.map(str::to_owned));
            }
            Some(_) if !continued && !member => {
                let mut path = vec![file.word(i).unwrap_or_default().to_owned()];
                while file.is_sign(i + 1, ':') && file.is_sign(i + 2, ':') && file.word(i + 3).is_some() {
                    path.extend(file.word(i + 3).map(str::to_owned));
                    i += 3;
                }
                // A lower-case word alone is a function only when it is called.
                let called = file.is_sign(i + 1, '(') || file.is_sign(i + 1, '!');
                if path.len() > 1 || called || path[0].starts_with(char::is_uppercase) {
                    named.push(NamedPath {
                        file: k,
                        module: here.clone(),
                        path: resolve_path(path, &here),
                    });
                }
            }
            _ => {
                if let Token::Sign(sign) = file.tokens[i].0 {
                    depth = match sign {
                        '{' => depth + 1,
                        '}' => depth.saturating_sub(1),
                        _ => depth,
                    };
                }
            }
        }
        i += 1;
    }
}

/// Follows paths through a crate's modules.
struct Lookup<'a> {
    names: &'a BTreeMap<ModuleKey, ModuleNames>,
    crate_folder: &'a str,
}

impl Lookup<'_> {
    fn module(&self, path: &[String]) -> Option<&ModuleNames> {
        self.names.get(&(self.crate_folder.to_owned(), path.to_vec()))
    }

    /// Where a path leads from a module; nothing when it leaves the crate.
    fn resolve(&self, module: &[String], path: &[String], depth: usize) -> Option<PathTarget> {
        let (mut at, mut rest) = match path.split_first() {
            Some((first, rest)) if first == "crate" => (Vec::new(), rest),
            _ => (module.to_vec(), path),
        };
        while let Some((name, more)) = rest.split_first() {
            match self.name_in(&at, name, depth)? {
                PathTarget::Module(inside) => (at, rest) = (inside, more),
                item @ PathTarget::ItemOf(_) => return Some(item),
            }
        }
        Some(PathTarget::Module(at))
    }

    /// What a module holds under a name.
    fn name_in(&self, at: &[String], name: &str, depth: usize) -> Option<PathTarget> {
        // Two modules may use all of each other.
        if depth > 8 {
            return None;
        }
        let module = self.module(at)?;
        let inside: Vec<String> = at.iter().cloned().chain([name.to_owned()]).collect();
        if self.module(&inside).is_some() {
            return Some(PathTarget::Module(inside));
        }
        if module.items.contains(name) {
            return Some(PathTarget::ItemOf(module.file));
        }
        if let Some(path) = module.aliases.get(name)
            && path.first().is_some_and(|first| first != name)
        {
            return self.resolve(at, path, depth + 1);
        }
        module
            .globs
            .iter()
            .find_map(|glob| match self.resolve(at, glob, depth + 1)? {
                PathTarget::Module(used) if used != at => self.name_in(&used, name, depth + 1),
                _ => None,
            })
    }
}
