//! Finds all imports between the files of a source tree, by parsing their syntax.
//!
//! A file imports from another file if it uses an item that the other file defines. Neither a
//! re-export nor `mod child;` is an import, so a `mod.rs` that only declares and re-exports has no
//! imports. A `mod.rs` that uses an item of its child imports from the child, and a child that uses
//! an item of its `mod.rs` imports from the `mod.rs`. Tests and comments are ignored. In macros,
//! names that are joined by `::` count as one path.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{
    Attribute, Expr, ExprCall, ExprPath, Item, ItemMod, ItemUse, Macro, UseTree, Visibility,
};

/// The crate name by which the program uses the library.
const LIBRARY: &str = "meniscus";

/// The path of a module: the names of its ancestors, followed by its name. Empty for the root.
type Module = Vec<String>;

/// A file that names an item of another file.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Import {
    pub from: String,
    /// The file that defines the item.
    pub to: String,
    /// The file of the module in the import's path, which may only re-export the item.
    pub via: String,
    /// The name of the item in that module.
    pub path: String,
}

/// Finds all imports between the files below a folder. Files are named by their paths relative to
/// the folder.
pub fn imports(folder: &Path) -> BTreeSet<Import> {
    let tree = Tree::read(folder);
    let mut imports = BTreeSet::new();
    for (module, file) in &tree.modules {
        let mut names =
            Names { tree: &tree, file, module: module.clone(), imports: BTreeSet::new() };
        names.visit_file(&file.syntax);
        imports.append(&mut names.imports);
    }
    imports
}

/// Finds all string literals below a folder, each with its file. Ignores comments and tests.
pub fn texts(folder: &Path) -> Vec<(String, String)> {
    let mut texts = Vec::new();
    for path in files(folder) {
        let tokens: TokenStream = fs::read_to_string(&path).unwrap().parse().unwrap();
        let name = path.strip_prefix(folder).unwrap().to_str().unwrap();
        add_texts(tokens, &mut |text| texts.push((name.to_owned(), text)));
    }
    texts
}

fn add_texts(tokens: TokenStream, add: &mut dyn FnMut(String)) {
    let mut of_test = false;
    for token in tokens {
        match token {
            TokenTree::Group(group) => {
                let inside = group.stream().to_string();
                if inside.replace(' ', "") == "cfg(test)" {
                    of_test = true;
                } else if of_test {
                    // Skip the test up to the end of its body in braces.
                    of_test = group.delimiter() != Delimiter::Brace;
                } else if !inside.starts_with("doc ") {
                    add_texts(group.stream(), add);
                }
            }
            TokenTree::Literal(literal) => {
                if let Ok(text) = syn::parse_str::<syn::LitStr>(&literal.to_string()) {
                    add(text.value());
                }
            }
            TokenTree::Ident(_) | TokenTree::Punct(_) => {}
        }
    }
}

/// The Rust files below a folder.
pub fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() {
            files.extend(self::files(&entry));
        } else if entry.extension().is_some_and(|extension| extension == "rs") {
            files.push(entry);
        }
    }
    files
}

struct File {
    name: String,
    syntax: syn::File,
    /// Maps each name that the module's `use` declarations define to the path of the item, and to
    /// whether the declaration re-exports the item.
    uses: BTreeMap<String, (Vec<String>, bool)>,
}

struct Tree {
    modules: BTreeMap<Module, File>,
}

impl Tree {
    fn read(folder: &Path) -> Self {
        let file = |path: PathBuf| {
            let name = path.strip_prefix(folder).unwrap().to_str().unwrap().to_owned();
            let syntax = syn::parse_file(&fs::read_to_string(path).unwrap()).expect(&name);
            let stem = name.strip_suffix(".rs").unwrap();
            let mut module: Module = stem.split('/').map(str::to_owned).collect();
            module.pop_if(|last| matches!(last.as_str(), "mod" | "lib"));
            let mut uses = BTreeMap::new();
            for item in &syntax.items {
                if let Item::Use(item) = item {
                    let public = !matches!(item.vis, Visibility::Inherited);
                    for (name, path) in leaves(&item.tree) {
                        uses.insert(name, (path, public));
                    }
                }
            }
            (module, File { name, syntax, uses })
        };
        // Ignore the bindings, which are separate crates.
        let bindings = folder.join("bindings");
        let modules = files(folder).into_iter().filter(|path| !path.starts_with(&bindings));
        Self { modules: modules.map(file).collect() }
    }

    /// Finds the module that defines an item, and the module that the item's path names. Returns
    /// `None` for items of other crates.
    fn find(&self, here: &[String], path: &[String]) -> Option<[Module; 2]> {
        let (first, rest) = path.split_first()?;
        let start = match first.as_str() {
            "crate" | LIBRARY => Module::new(),
            "self" => here.to_vec(),
            "super" => here.split_last()?.1.to_vec(),
            child if self.modules.contains_key(&joined(here, child)) && !rest.is_empty() => {
                joined(here, child)
            }
            name => {
                let (used, _) = self.modules.get(here)?.uses.get(name)?;
                // A name that resolves to itself is the name of a crate, or a macro of this file.
                return if used[0] == *name {
                    None
                } else {
                    self.find(here, &[used, rest].concat())
                };
            }
        };
        let (mut via, mut rest) = (start, rest);
        while let Some((next, later)) = rest.split_first() {
            if next == "super" {
                via.pop();
            } else if self.modules.contains_key(&joined(&via, next)) {
                via.push(next.clone());
            } else {
                break;
            }
            rest = later;
        }
        // A module without its own file belongs to the file of its parent.
        while !self.modules.contains_key(&via) {
            via.pop()?;
        }
        let defined = rest.first().filter(|name| self.modules[&via].uses.contains_key(*name));
        let defined =
            defined.and_then(|_| self.find(&via, rest)).map_or(via.clone(), |[defined, _]| defined);
        Some([defined, via])
    }
}

fn joined(module: &[String], child: &str) -> Module {
    module.iter().cloned().chain([child.to_owned()]).collect()
}

/// The items of a `use` declaration: the local name and the path of each item.
fn leaves(tree: &UseTree) -> Vec<(String, Vec<String>)> {
    match tree {
        UseTree::Path(path) => leaves(&path.tree)
            .into_iter()
            .map(|(name, rest)| {
                let first = path.ident.to_string();
                let name = if name == "self" { first.clone() } else { name };
                let rest = rest.into_iter().filter(|part| part != "self");
                (name, [first].into_iter().chain(rest).collect())
            })
            .collect(),
        UseTree::Name(name) => vec![(name.ident.to_string(), vec![name.ident.to_string()])],
        UseTree::Rename(rename) => {
            vec![(rename.rename.to_string(), vec![rename.ident.to_string()])]
        }
        UseTree::Glob(_) => vec![("*".to_owned(), vec!["*".to_owned()])],
        UseTree::Group(group) => group.items.iter().flat_map(leaves).collect(),
    }
}

/// Collects the items that a file names.
struct Names<'a> {
    tree: &'a Tree,
    file: &'a File,
    module: Module,
    imports: BTreeSet<Import>,
}

impl Names<'_> {
    fn name(&mut self, path: &[String]) {
        let Some([to, via]) = self.tree.find(&self.module, path) else { return };
        let file = |module: &Module| self.tree.modules[module].name.clone();
        let (from, to, via) = (self.file.name.clone(), file(&to), file(&via));
        if from != to {
            self.imports.insert(Import { from, to, via, path: path.join("::") });
        }
    }

    /// Adds a path that occurs in code, unless a private `use` has already named its item.
    fn mention(&mut self, path: &[String]) {
        if self.file.uses.get(&path[0]).is_none_or(|(_, public)| *public) {
            self.name(path);
        }
    }
}

fn is_test_only(attributes: &[Attribute]) -> bool {
    let is_test = |attribute: &Attribute| {
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<syn::Path>().is_ok_and(|path| path.is_ident("test"))
    };
    attributes.iter().any(is_test)
}

fn starts_lowercase(name: &str) -> bool {
    name.starts_with(|first: char| first.is_lowercase())
}

impl<'ast> Visit<'ast> for Names<'_> {
    fn visit_item_mod(&mut self, item: &'ast ItemMod) {
        if is_test_only(&item.attrs) || item.content.is_none() {
            return;
        }
        self.module.push(item.ident.to_string());
        visit::visit_item_mod(self, item);
        self.module.pop();
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        if matches!(item.vis, Visibility::Inherited) {
            leaves(&item.tree).iter().for_each(|(_, path)| self.name(path));
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names: Vec<String> =
            path.segments.iter().map(|segment| segment.ident.to_string()).collect();
        // A single lower-case name is a variable, unless it is called.
        if names.len() > 1 || !starts_lowercase(&names[0]) {
            self.mention(&names);
        }
        visit::visit_path(self, path);
    }

    fn visit_expr_call(&mut self, call: &'ast ExprCall) {
        if let Expr::Path(ExprPath { path, .. }) = &*call.func
            && let Some(name) = path.get_ident()
        {
            self.mention(&[name.to_string()]);
        }
        visit::visit_expr_call(self, call);
    }

    fn visit_visibility(&mut self, _: &'ast Visibility) {}

    fn visit_attribute(&mut self, _: &'ast Attribute) {}

    fn visit_macro(&mut self, call: &'ast Macro) {
        visit::visit_macro(self, call);
        for names in paths(call.tokens.clone()) {
            if names.len() > 1 || !starts_lowercase(&names[0]) {
                self.mention(&names);
            }
        }
    }
}

/// Finds all names in a macro. Names that are joined by `::` form one path.
fn paths(tokens: TokenStream) -> Vec<Vec<String>> {
    let mut paths: Vec<Vec<String>> = Vec::new();
    let mut colons = 0;
    for token in tokens {
        match token {
            TokenTree::Ident(name) if colons == 2 && !paths.is_empty() => {
                paths.last_mut().unwrap().push(name.to_string());
            }
            TokenTree::Ident(name) => paths.push(vec![name.to_string()]),
            TokenTree::Punct(punct) if punct.as_char() == ':' => {
                colons += 1;
                continue;
            }
            TokenTree::Group(group) => paths.extend(self::paths(group.stream())),
            _ => {}
        }
        colons = 0;
    }
    paths
}
