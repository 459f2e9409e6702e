//! What the text of a script may hold, counted while it is parsed.
//!
//! The language's parser looks through all variables, functions and parameters at each name, and its interpreter tries all
//! types of all arguments where a function is not found: a text of a megabyte could keep both busy for minutes. So what one
//! call, scope or literal may hold has a limit, and the first token over it ends the parsing. So does what would reach values
//! past the count of what is read.

use super::fault::syntax;
use presight_model::error::{Error, Result};
use presight_model::limits;
use rhai::{AST, Engine, LexError, Position, Token};
use std::cell::{Cell, RefCell};
use std::path::Path;
use std::rc::Rc;

/// What a text has too much of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Excess {
    Arguments,
    Elements,
    Entries,
    Functions,
    /// What reaches values that are not counted when they are read.
    Hidden,
    Literal,
    NameBytes,
    Nesting,
    Variables,
}

impl Excess {
    /// What is wrong, and the remedy.
    pub fn in_words(self) -> (String, &'static str) {
        match self {
            Self::Arguments => {
                (format!("a call has over {} arguments", limits::MAX_SCRIPT_ARGUMENTS), "hand over an array")
            }
            Self::Elements => {
                (format!("an array has over {} elements", limits::MAX_SCRIPT_ARRAY), "fill it in a loop, or split it")
            }
            Self::Entries => (
                format!("a block or map has over {} entries", limits::MAX_SCRIPT_MAP),
                "split it, or fill it in a loop",
            ),
            Self::Functions => {
                (format!("over {} functions", limits::MAX_SCRIPT_FUNCTIONS), "put some into modules of their own")
            }
            Self::Hidden => (
                "functions see their parameters only: there is no `this` and no `global::`".to_owned(),
                "hand the value over, or put it into a function that returns it",
            ),
            Self::Literal => {
                (format!("a string is over {} bytes", limits::MAX_SCRIPT_LITERAL), "add several, or read less")
            }
            Self::NameBytes => (format!("a name is over {} bytes", limits::MAX_SCRIPT_NAME), "give a shorter one"),
            Self::Nesting => {
                (format!("expressions nest over {} levels", limits::MAX_SCRIPT_NESTING), "split them by variables")
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
    /// What a comma in it separates.
    of: Excess,
    commas: usize,
    /// Variables that were there when it was opened, of those all that its function does not see.
    variables: usize,
    unseen: usize,
}

/// What of a text was parsed so far.
struct Parsed {
    /// The first is the whole text.
    brackets: Vec<Bracket>,
    /// Names of the variables and modules that are known, those of an inner block last.
    variables: Vec<String>,
    unseen: usize,
    functions: usize,
    /// The next name is a new variable's.
    declares: bool,
    /// The next block is a function's.
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

/// Counts what parsers read.
#[derive(Clone, Default)]
pub(super) struct Tokens {
    parsed: Rc<RefCell<Parsed>>,
    /// Bytes of all texts so far.
    bytes: Rc<Cell<usize>>,
}

impl Tokens {
    /// Watches all that an engine parses.
    pub fn watch(&self, engine: &mut Engine) {
        let parsed = self.parsed.clone();
        #[expect(deprecated, reason = "it is not, the library says: it may change")]
        engine.on_parse_token(move |token, at, _| parsed.borrow_mut().next(token, at));
    }

    /// Parses a text; errors name the file.
    pub fn parse(&self, engine: &Engine, text: &str, file: &Path) -> Result<AST> {
        self.bytes.set(self.bytes.get().saturating_add(text.len()));
        if self.bytes.get() > limits::MAX_SCRIPT_TEXT {
            let what = format!("the script and its modules have over {} bytes", limits::MAX_SCRIPT_TEXT);
            return Err(Error::invalid(what, "leave out what is not needed").in_file(file));
        }
        *self.parsed.borrow_mut() = Parsed::default();
        engine.compile(text).map_err(|e| match self.parsed.take().excess {
            None => syntax(&e, file),
            Some((excess, at)) => {
                let (what, remedy) = excess.in_words();
                let (line, column) = (at.line().unwrap_or(0), at.position().unwrap_or(0));
                Error::invalid(what, remedy).at(format!("line {line}, column {column}")).in_file(file)
            }
        })
    }
}

impl Parsed {
    /// The token itself, or what ends the parsing.
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
            // Between the statements of a block, which are not counted.
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
        // Anything else is a mistake, which the parser tells of.
        if let Some(bracket) = self.brackets.pop_if(|bracket| bracket.closed_by == *token) {
            self.variables.truncate(bracket.variables);
            self.unseen = bracket.unseen;
        }
    }

    /// What a bracket has too much of if a token begins one more; a comma may stand behind the last.
    fn over_full(&self, token: &Token) -> Option<Excess> {
        let bracket = self.brackets.last().filter(|bracket| bracket.closed_by != *token)?;
        let most = match bracket.of {
            Excess::Arguments => limits::MAX_SCRIPT_ARGUMENTS,
            Excess::Elements => limits::MAX_SCRIPT_ARRAY,
            _ => limits::MAX_SCRIPT_MAP,
        };
        (bracket.commas >= most).then_some(bracket.of)
    }

    /// A variable that its own block knows already gets another value.
    fn declare(&mut self, name: &str) -> Option<Excess> {
        let block = self.brackets.last().map_or(0, |bracket| bracket.variables);
        if self.variables[block..].iter().any(|known| known == name) {
            return None;
        }
        self.variables.push(name.to_owned());
        (self.variables.len() - self.unseen > limits::MAX_SCRIPT_VARIABLES).then_some(Excess::Variables)
    }
}
