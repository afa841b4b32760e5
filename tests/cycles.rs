//! No files import each other in a circle, neither across modules nor within one, so that every file can be read after those
//! that it depends on. The sources are parsed; an import is attributed to the file that defines the item, also for re-exports.

#![expect(clippy::expect_used, reason = "a test may fail")]

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs;
use std::path::{Path, PathBuf};
use syn::visit::{self, Visit};
use syn::{Attribute, Item, ItemMod, ItemUse, UseTree, VisRestricted};

/// The path of a module, starting with the root of its crate.
type ModulePath = Vec<String>;

/// The calculation is a separate crate, whose modules `coaxis` re-exports.
const ROOTS: [(&str, &str); 2] = [("coaxis", "src/lib.rs"), ("coaxis_calculation", "src/calculation/lib.rs")];
const CALCULATION: [&str; 5] = ["estimation", "geometry", "motion", "plot", "scan"];

fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg") && attribute.parse_args::<syn::Path>().is_ok_and(|path| path.is_ident("test"))
    })
}

/// Reads a module and its submodules, without the tests.
fn read(file: &Path, path: ModulePath, modules: &mut BTreeMap<ModulePath, syn::File>) {
    let text = fs::read_to_string(file).expect("readable source");
    let parsed = syn::parse_file(&text).expect("source of Rust");
    let stem = file.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    let folder = file.parent().expect("in a folder");
    let inside = if ["lib", "mod"].contains(&stem) { folder.to_path_buf() } else { folder.join(stem) };
    for item in &parsed.items {
        if let Item::Mod(ItemMod { attrs, ident, content: None, .. }) = item
            && !is_test(attrs)
        {
            let places: [PathBuf; 2] =
                [inside.join(format!("{ident}.rs")), inside.join(ident.to_string()).join("mod.rs")];
            let place = places.iter().find(|place| place.exists()).expect("the file of a module");
            read(place, path.iter().cloned().chain([ident.to_string()]).collect(), modules);
        }
    }
    modules.insert(path, parsed);
}

/// The paths in a file, outside its tests.
#[derive(Default)]
struct Paths(Vec<Vec<String>>);

impl Paths {
    fn take(&mut self, tree: &UseTree, mut before: Vec<String>) {
        match tree {
            UseTree::Path(path) => {
                before.push(path.ident.to_string());
                self.take(&path.tree, before);
            }
            UseTree::Name(name) => self.0.push(before.into_iter().chain([name.ident.to_string()]).collect()),
            UseTree::Rename(name) => self.0.push(before.into_iter().chain([name.ident.to_string()]).collect()),
            UseTree::Glob(_) => self.0.push(before),
            UseTree::Group(group) => group.items.iter().for_each(|tree| self.take(tree, before.clone())),
        }
    }
}

impl<'ast> Visit<'ast> for Paths {
    fn visit_item_mod(&mut self, module: &'ast ItemMod) {
        if !is_test(&module.attrs) {
            visit::visit_item_mod(self, module);
        }
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        self.take(&item.tree, Vec::new());
    }

    /// A visibility names a module but imports nothing.
    fn visit_vis_restricted(&mut self, _: &'ast VisRestricted) {}

    fn visit_path(&mut self, path: &'ast syn::Path) {
        if path.segments.len() > 1 {
            self.0.push(path.segments.iter().map(|segment| segment.ident.to_string()).collect());
        }
        visit::visit_path(self, path);
    }
}

/// The module that a path refers to; `None` if it is outside the two crates, or an item of the same file.
fn target(from: &ModulePath, path: &[String], modules: &BTreeMap<ModulePath, syn::File>) -> Option<ModulePath> {
    let mut at = from.clone();
    let mut rest = path.iter().peekable();
    match rest.peek()?.as_str() {
        "crate" => {
            rest.next();
            at.truncate(1);
        }
        "self" => {
            rest.next();
        }
        "super" => {
            while rest.next_if(|part| *part == "super").is_some() {
                at.pop();
            }
        }
        first => {
            at.push(first.to_owned());
            if !modules.contains_key(&at) {
                return None;
            }
            rest.next();
        }
    }
    for part in rest {
        if at == ["coaxis"] && CALCULATION.contains(&part.as_str()) {
            at = vec!["coaxis_calculation".to_owned()];
        }
        at.push(part.clone());
        if !modules.contains_key(&at) {
            at.pop();
            break;
        }
    }
    (at != *from).then_some(at)
}

/// The shortest circle of imports through a module.
fn circle(start: &ModulePath, imports: &BTreeMap<ModulePath, BTreeSet<ModulePath>>) -> Option<Vec<ModulePath>> {
    let mut queue = VecDeque::from([vec![start.clone()]]);
    let mut seen = BTreeSet::new();
    while let Some(way) = queue.pop_front() {
        for next in imports.get(way.last()?)? {
            let further = way.iter().cloned().chain([next.clone()]).collect();
            if next == start {
                return Some(further);
            }
            if seen.insert(next.clone()) {
                queue.push_back(further);
            }
        }
    }
    None
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut modules = BTreeMap::new();
    for (name, file) in ROOTS {
        read(&root.join(file), vec![name.to_owned()], &mut modules);
    }
    let imports: BTreeMap<ModulePath, BTreeSet<ModulePath>> = modules
        .iter()
        .map(|(path, file)| {
            let mut paths = Paths::default();
            paths.visit_file(file);
            (path.clone(), paths.0.iter().filter_map(|named| target(path, named, &modules)).collect())
        })
        .collect();
    assert!(imports.len() > 100, "only {} files were read", imports.len());
    let circles = imports.keys().filter_map(|start| circle(start, &imports));
    let shortest = circles.min_by_key(Vec::len);
    let named = shortest.map(|way| way.iter().map(|path| path.join("::")).collect::<Vec<_>>().join("\n  imports "));
    assert_eq!(named, None, "move the shared items to a separate file");
}
