//! The worst stack of a program, from its machine code: what each function pushes, and whom it calls.
//!
//! The bound is the deepest path from the reset vector, plus an exception's frame and the deepest handler,
//! twice: handlers have two priorities, of which the upper interrupts the lower. Calls through pointers can't
//! be followed; their number is told.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use super::elf::Elf;

/// Bytes that the processor pushes at an interrupt, floating-point registers included, and for alignment.
const EXCEPTION_FRAME: u32 = 108;

/// What was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Stack {
    /// Bound of the stack, bytes.
    pub(crate) bytes: u32,
    /// Calls through pointers, which the bound leaves out.
    pub(crate) pointers: usize,
    /// Whether a function can reach itself; the bound counts it once.
    pub(crate) recursive: bool,
}

/// What a function's code does to the stack.
#[derive(Debug, Default)]
struct Function {
    frame: u32,
    calls: BTreeSet<u32>,
    pointers: usize,
}

/// What an instruction does to the stack.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Effect {
    None,
    Push(u32),
    Go(u32),
    Pointer,
}

/// The bound for a program whose vector table is at `vectors`.
pub(crate) fn worst(elf: &Elf, vectors: u32) -> Stack {
    let functions = functions(elf);
    let mut walk = Walk { functions: &functions, known: HashMap::new(), path: Vec::new(), recursive: false };
    let reset = walk.depth(elf.word_at(vectors + 4).unwrap_or(0) & !1);
    let handlers = (2..).map_while(|entry| elf.word_at(vectors + 4 * entry)).take(110);
    let handler = handlers.map(|address| walk.depth(address & !1)).max().unwrap_or(0);
    let pointers = functions.values().map(|function| function.pointers).sum();
    Stack { bytes: reset + 2 * (EXCEPTION_FRAME + handler), pointers, recursive: walk.recursive }
}

/// All functions by their addresses.
fn functions(elf: &Elf) -> BTreeMap<u32, Function> {
    let symbols = elf.symbols();
    let starts: BTreeSet<u32> =
        symbols.iter().filter(|symbol| symbol.is_function).map(|symbol| symbol.value & !1).collect();
    // $t and $d mark where code and constants begin.
    let marks: BTreeMap<u32, bool> = symbols
        .iter()
        .filter(|symbol| symbol.name.starts_with("$t") || symbol.name.starts_with("$d"))
        .map(|symbol| (symbol.value & !1, symbol.name.starts_with("$t")))
        .collect();
    let mut functions = BTreeMap::new();
    for &start in &starts {
        let mut function = Function::default();
        let mut at = start;
        let end = starts.range(start + 1..).next().copied().unwrap_or(u32::MAX);
        while at < end {
            let Some(first) = elf.half_at(at) else { break };
            if marks.range(..=at).next_back().is_some_and(|(_, &is_code)| !is_code) {
                at += 2;
                continue;
            }
            let wide = first >= 0xE800;
            let second = if wide { elf.half_at(at + 2).unwrap_or(0) } else { 0 };
            match effect(at, first, second) {
                Effect::None => {}
                Effect::Push(bytes) => function.frame += bytes,
                Effect::Go(to) if to != start && starts.contains(&to) => _ = function.calls.insert(to),
                Effect::Go(to) if to == start => _ = function.calls.insert(to),
                Effect::Go(_) => {}
                Effect::Pointer => function.pointers += 1,
            }
            at += if wide { 4 } else { 2 };
        }
        functions.insert(start, function);
    }
    functions
}

/// Decodes what matters of Thumb-2.
fn effect(at: u32, first: u16, second: u16) -> Effect {
    let (a, b) = (u32::from(first), u32::from(second));
    match (a, b) {
        // push {…}, push {…, lr}
        _ if a & 0xFE00 == 0xB400 => Effect::Push(4 * (a & 0x1FF).count_ones()),
        // sub sp, #…
        _ if a & 0xFF80 == 0xB080 => Effect::Push(4 * (a & 0x7F)),
        // blx register
        _ if a & 0xFF87 == 0x4780 => Effect::Pointer,
        // bx register other than lr
        _ if a & 0xFF87 == 0x4700 && a & 0x78 != 0x70 => Effect::Pointer,
        // push.w {…}
        (0xE92D, _) => Effect::Push(4 * b.count_ones()),
        // push.w of one register: str …, [sp, #-4]!
        (0xF84D, _) if b & 0xFFF == 0xD04 => Effect::Push(4),
        // vpush of doubles
        _ if a & 0xFFBF == 0xED2D => Effect::Push(4 * (b & 0xFF)),
        // sub.w sp, sp, #constant
        _ if a & 0xFBFF == 0xF1AD && b & 0x8F00 == 0x0D00 => Effect::Push(expand(a >> 10 & 1, b)),
        // subw sp, sp, #constant
        _ if a & 0xFBFF == 0xF2AD && b & 0x8F00 == 0x0D00 => {
            Effect::Push((a >> 10 & 1) << 11 | (b >> 12 & 7) << 8 | b & 0xFF)
        }
        // bl, and b.w, which may be a call at a function's end
        _ if a & 0xF800 == 0xF000 && (b & 0xD000 == 0xD000 || b & 0xD000 == 0x9000) => {
            let sign = a >> 10 & 1;
            let (i1, i2) = (!(b >> 13 ^ sign) & 1, !(b >> 11 ^ sign) & 1);
            let offset = sign << 24 | i1 << 23 | i2 << 22 | (a & 0x3FF) << 12 | (b & 0x7FF) << 1;
            let offset = (offset << 7) as i32 >> 7;
            Effect::Go((at + 4).wrapping_add_signed(offset))
        }
        // b
        _ if a & 0xF800 == 0xE000 => {
            let offset = (a << 21) as i32 >> 20;
            Effect::Go((at + 4).wrapping_add_signed(offset))
        }
        _ => Effect::None,
    }
}

/// A Thumb-2 modified constant.
fn expand(i: u32, second: u32) -> u32 {
    let code = i << 11 | (second >> 12 & 7) << 8 | second & 0xFF;
    let byte = code & 0xFF;
    match code >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte * 0x0101_0101,
        _ => (0x80 | code & 0x7F).rotate_right(code >> 7),
    }
}

/// A walk down the calls.
struct Walk<'a> {
    functions: &'a BTreeMap<u32, Function>,
    known: HashMap<u32, u32>,
    path: Vec<u32>,
    recursive: bool,
}

impl Walk<'_> {
    /// The deepest stack from a function on.
    fn depth(&mut self, start: u32) -> u32 {
        if let Some(&depth) = self.known.get(&start) {
            return depth;
        }
        let functions = self.functions;
        let Some(function) = functions.get(&start) else { return 0 };
        self.path.push(start);
        let mut below = 0;
        for &called in &function.calls {
            if self.path.contains(&called) {
                // A branch back to a function's own start is a loop that needs no stack.
                self.recursive |= called != start || function.frame > 0;
                continue;
            }
            below = self.depth(called).max(below);
        }
        self.path.pop();
        self.known.insert(start, function.frame + below);
        function.frame + below
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instructions_that_move_the_stack_are_decoded() {
        // push {r4, r7, lr}; sub sp, #16; push.w {r8-r11}; sub.w sp, sp, #1024; subw sp, sp, #1004; vpush
        // {d8-d9}
        assert_eq!(effect(0, 0xB590, 0), Effect::Push(12));
        assert_eq!(effect(0, 0xB084, 0), Effect::Push(16));
        assert_eq!(effect(0, 0xE92D, 0x0F00), Effect::Push(16));
        assert_eq!(effect(0, 0xF5AD, 0x6D80), Effect::Push(1024));
        assert_eq!(effect(0, 0xF2AD, 0x3DEC), Effect::Push(1004));
        assert_eq!(effect(0, 0xED2D, 0x8B04), Effect::Push(16));
        // str r11, [sp, #-4]!
        assert_eq!(effect(0, 0xF84D, 0xBD04), Effect::Push(4));
    }

    #[test]
    fn calls_are_followed_forward_and_back() {
        // bl +4 past itself; bl to itself; b.w to itself; b to itself; blx r3; bx lr
        assert_eq!(effect(0x100, 0xF000, 0xF800), Effect::Go(0x104));
        assert_eq!(effect(0x100, 0xF7FF, 0xFFFE), Effect::Go(0x100));
        assert_eq!(effect(0x100, 0xF7FF, 0xBFFE), Effect::Go(0x100));
        assert_eq!(effect(0x100, 0xE7FE, 0), Effect::Go(0x100));
        assert_eq!(effect(0x100, 0x4798, 0), Effect::Pointer);
        assert_eq!(effect(0x100, 0x4770, 0), Effect::None);
    }
}
