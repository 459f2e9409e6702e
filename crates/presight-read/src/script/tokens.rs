//! Limits on the text of a script, checked while it is parsed.
//!
//! Rhai's parser searches all variables, functions and parameters at each name. Its interpreter tries all types of all
//! arguments of an unknown function. A text of one megabyte could keep both busy for minutes. So calls, scopes and
//! literals have size limits, and the first token over a limit ends the parsing. Tokens that give access to uncounted
//! values end it too.

use super::fault::syntax;
use presight_model::error::{Error, Result};
use presight_model::limits;
use rhai::{AST, Engine, LexError, Position, Token};
use std::cell::{Cell, RefCell};
use std::rc::Rc;

/// The limit that a text exceeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Excess {
    Arguments,
    Elements,
    Entries,
    Functions,
    /// `this` and `global::`, whose values are not counted when they are read.
    Hidden,
    Literal,
    NameBytes,
    Nesting,
    Variables,
}

impl Excess {
    /// Message and remedy.
    pub fn in_words(self) -> (String, &'static str) {
        match self {
            Self::Arguments => (format!("a call has over {} arguments", limits::MAX_SCRIPT_ARGUMENTS), "pass an array"),
            Self::Elements => {
                (format!("an array has over {} elements", limits::MAX_SCRIPT_ARRAY), "fill it in a loop, or split it")
            }
            Self::Entries => (
                format!("a block or map has over {} entries", limits::MAX_SCRIPT_MAP),
                "split it, or fill it in a loop",
            ),
            Self::Functions => (format!("over {} functions", limits::MAX_SCRIPT_FUNCTIONS), "move some into modules"),
            Self::Hidden => (
                "functions see only their parameters: there is no `this` and no `global::`".to_owned(),
                "pass the value as a parameter, or return it from a function",
            ),
            Self::Literal => {
                (format!("a string is over {} bytes", limits::MAX_SCRIPT_LITERAL), "join shorter ones with +")
            }
            Self::NameBytes => (format!("a name is over {} bytes", limits::MAX_SCRIPT_NAME), "give a shorter one"),
            Self::Nesting => {
                (format!("expressions nest over {} levels", limits::MAX_SCRIPT_NESTING), "split them with variables")
            }
            Self::Variables => (
                format!("over {} variables", limits::MAX_SCRIPT_VARIABLES),
                "keep many values in an array, or use them in functions or blocks { .. }",
            ),
        }
    }
}

/// An open bracket.
struct Bracket {
    closed_by: Token,
    /// The kind of items that commas in it separate.
    of: Excess,
    commas: usize,
    /// Number of known variables when it was opened.
    variables: usize,
    /// Number of known variables that the enclosing function cannot see.
    unseen: usize,
}

/// State of the text parsed so far.
struct Parsed {
    /// Open brackets; the first stands for the whole text.
    brackets: Vec<Bracket>,
    /// Names of the known variables and modules, from the outermost block to the innermost.
    variables: Vec<String>,
    unseen: usize,
    functions: usize,
    /// The next name declares a variable or module.
    declares: bool,
    /// The next block is the body of a function.
    in_signature: bool,
    /// The last name was `global`.
    after_global: bool,
    excess: Option<(Excess, Position)>,
}

impl Default for Parsed {
    fn default() -> Self {
        let whole = Bracket { closed_by: Token::EOF, of: Excess::Entries, commas: 0, variables: 0, unseen: 0 };
        Self {
            brackets: vec![whole],
            variables: Vec::new(),
            unseen: 0,
            functions: 0,
            declares: false,
            in_signature: false,
            after_global: false,
            excess: None,
        }
    }
}

/// Counts the tokens that Rhai parses.
#[derive(Clone, Default)]
pub(super) struct Tokens {
    parsed: Rc<RefCell<Parsed>>,
    /// Total bytes of all texts so far.
    bytes: Rc<Cell<usize>>,
}

impl Tokens {
    /// Counts every token that an engine parses.
    pub fn watch(&self, engine: &mut Engine) {
        let parsed = self.parsed.clone();
        #[expect(deprecated, reason = "not deprecated, only unstable")]
        engine.on_parse_token(move |token, at, _| parsed.borrow_mut().next(token, at));
    }

    /// Parses a text.
    pub fn parse(&self, engine: &Engine, text: &str) -> Result<AST> {
        self.bytes.set(self.bytes.get().saturating_add(text.len()));
        if self.bytes.get() > limits::MAX_SCRIPT_TEXT {
            let what = format!("the script and its modules have over {} bytes", limits::MAX_SCRIPT_TEXT);
            return Err(Error::invalid(what, "remove unused parts"));
        }
        *self.parsed.borrow_mut() = Parsed::default();
        engine.compile(text).map_err(|e| match self.parsed.take().excess {
            None => syntax(&e),
            Some((excess, at)) => {
                let (what, remedy) = excess.in_words();
                let (line, column) = (at.line().unwrap_or(0), at.position().unwrap_or(0));
                Error::invalid(what, remedy).at(format!("line {line}, column {column}"))
            }
        })
    }
}

impl Parsed {
    /// Returns the token, or an error token that ends the parsing.
    fn next(&mut self, token: Token, at: Position) -> Token {
        if self.excess.is_none() {
            self.excess = self.over_full(&token).or_else(|| self.count(&token)).map(|excess| (excess, at));
        }
        match self.excess {
            None => token,
            Some((excess, _)) => Token::LexError(LexError::Runtime(excess.in_words().0).into()),
        }
    }

    fn count(&mut self, token: &Token) -> Option<Excess> {
        let declares = std::mem::take(&mut self.declares);
        let after_global = std::mem::take(&mut self.after_global);
        match token {
            Token::LeftParen => return self.open(Token::RightParen, Excess::Arguments),
            Token::LeftBracket | Token::QuestionBracket => return self.open(Token::RightBracket, Excess::Elements),
            Token::LeftBrace | Token::MapStart => return self.open(Token::RightBrace, Excess::Entries),
            Token::RightParen | Token::RightBracket | Token::RightBrace => self.close(token),
            Token::Comma => self.brackets.last_mut().into_iter().for_each(|bracket| bracket.commas += 1),
            // Statements of a block are not counted, so its commas start again.
            Token::SemiColon => self.brackets.last_mut().into_iter().for_each(|bracket| bracket.commas = 0),
            Token::Let | Token::Const | Token::As => self.declares = true,
            Token::Fn => {
                self.in_signature = true;
                self.functions += 1;
                return (self.functions > limits::MAX_SCRIPT_FUNCTIONS).then_some(Excess::Functions);
            }
            Token::DoubleColon if after_global => return Some(Excess::Hidden),
            Token::Reserved(name) if name.as_str() == "this" => return Some(Excess::Hidden),
            Token::StringConstant(text) | Token::InterpolatedString(text) => {
                return (text.len() > limits::MAX_SCRIPT_LITERAL).then_some(Excess::Literal);
            }
            Token::Identifier(name) if name.len() > limits::MAX_SCRIPT_NAME => return Some(Excess::NameBytes),
            Token::Identifier(name) if declares => return self.declare(name),
            Token::Identifier(name) => self.after_global = name.as_str() == "global",
            _ => {}
        }
        None
    }

    fn open(&mut self, closed_by: Token, of: Excess) -> Option<Excess> {
        let (variables, unseen) = (self.variables.len(), self.unseen);
        if closed_by == Token::RightBrace && std::mem::take(&mut self.in_signature) {
            self.unseen = variables;
        }
        self.brackets.push(Bracket { closed_by, of, commas: 0, variables, unseen });
        (self.brackets.len() - 1 > limits::MAX_SCRIPT_NESTING).then_some(Excess::Nesting)
    }

    fn close(&mut self, token: &Token) {
        // A bracket that does not match is an error, which the parser reports.
        if let Some(bracket) = self.brackets.pop_if(|bracket| bracket.closed_by == *token) {
            self.variables.truncate(bracket.variables);
            self.unseen = bracket.unseen;
        }
    }

    /// Returns the limit that a bracket exceeds if `token` begins another item. A trailing comma begins none.
    fn over_full(&self, token: &Token) -> Option<Excess> {
        let bracket = self.brackets.last().filter(|bracket| bracket.closed_by != *token)?;
        let most = match bracket.of {
            Excess::Arguments => limits::MAX_SCRIPT_ARGUMENTS,
            Excess::Elements => limits::MAX_SCRIPT_ARRAY,
            _ => limits::MAX_SCRIPT_MAP,
        };
        (bracket.commas >= most).then_some(bracket.of)
    }

    /// Declares a name. In the same block, a repeated declaration replaces the first and does not count.
    fn declare(&mut self, name: &str) -> Option<Excess> {
        let block = self.brackets.last().map_or(0, |bracket| bracket.variables);
        if self.variables[block..].iter().any(|known| known == name) {
            return None;
        }
        self.variables.push(name.to_owned());
        (self.variables.len() - self.unseen > limits::MAX_SCRIPT_VARIABLES).then_some(Excess::Variables)
    }
}
