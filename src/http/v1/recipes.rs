//! Named recipes with entity tags, so that no client overwrites a revision that it has not read.

pub(in crate::http) mod document;

pub(in crate::http) use document::RecipeDocument;

use crate::http::app::App;
use crate::http::wire::body::header_text;
use crate::http::wire::extract::{Json as JsonBody, NoQuery, Path, Query};
use crate::http::wire::paging::{EntryDocument, PageQuery, listed};
use crate::http::wire::problem::{Code, Problem};
use crate::service::{Entry, Put, RecipeName, StoredRecipe};
use crate::store::Precondition;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

/// A recipe with what is known about its revision.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = StoredRecipe)]
pub(in crate::http) struct StoredRecipeDocument {
    /// Its name.
    #[schema(pattern = "^[a-z0-9][a-z0-9_-]{0,63}$")]
    name: String,
    /// Counts up from 1.
    revision: u64,
    /// Names the revision; goes into If-Match to replace it.
    etag: String,
    /// When the first revision was put, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    created_at: Timestamp,
    /// When this revision was put, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    updated_at: Timestamp,
    /// What it says.
    recipe: RecipeDocument,
}

/// A page of recipes, the latest made first.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::http) struct RecipeList {
    /// The recipes.
    recipes: Vec<EntryDocument<StoredRecipeDocument>>,
    /// The `cursor` of the next page; null at the end.
    next_cursor: Option<String>,
}

/// List recipes
///
/// The latest made first, by the page. The header `Link` names the next page.
#[utoipa::path(
    get, path = "/v1/recipes", tag = "recipes", params(PageQuery),
    responses((status = 200, description = "A page of recipes", body = RecipeList,
        headers(("Link" = String, description = "The next page, rel=\"next\"; absent at the end"))))
)]
pub(in crate::http) async fn list_recipes(
    State(app): State<App>,
    Query(query): Query<PageQuery>,
    uri: Uri,
) -> Result<Response, Problem> {
    let page = app.service.measuring.recipes(&query.page()?).await?;
    let document = |rows: Vec<Entry<StoredRecipe>>, next_cursor| {
        let show = |entry| EntryDocument::of(entry, StoredRecipeDocument::from);
        RecipeList { recipes: rows.into_iter().map(show).collect(), next_cursor }
    };
    listed(&uri, page, document).await
}

/// Get a recipe
///
/// Its current revision, named by the header `ETag`.
#[utoipa::path(
    get, path = "/v1/recipes/{name}", tag = "recipes",
    params(("name" = String, Path, description = "Name of the recipe")),
    responses((status = 200, description = "The recipe", body = StoredRecipeDocument,
        headers(("ETag" = String, description = "Names the revision"))))
)]
pub(in crate::http) async fn get_recipe(
    State(app): State<App>,
    Path(name): Path<String>,
    _: NoQuery,
) -> Result<Response, Problem> {
    let name = RecipeName::parse(&name).ok_or_else(|| {
        Problem::new(Code::RecipeUnknown, format!("there is no recipe {name}; list them with GET /v1/recipes"))
    })?;
    answer(StatusCode::OK, app.service.measuring.recipe(&name).await?)
}

/// Put a recipe
///
/// A new name needs no header. Replacing a recipe needs `If-Match` with the `ETag` of the revision that is replaced, so
/// that nobody overwrites what he has not seen; `If-Match: *` replaces whatever is there, `If-None-Match: *` only makes
/// a new one.
#[utoipa::path(
    put, path = "/v1/recipes/{name}", tag = "recipes",
    params(
        ("name" = String, Path, description = "Name of the recipe", pattern = "^[a-z0-9][a-z0-9_-]{0,63}$"),
        ("If-Match" = Option<String>, Header, description = "ETag of the revision that is replaced, or *"),
        ("If-None-Match" = Option<String>, Header, description = "* to make a new one only"),
    ),
    request_body(content = RecipeDocument, description = "The fields of the recipe; a missing field keeps its default"),
    responses(
        (status = 201, description = "The first of its name", body = StoredRecipeDocument,
            headers(("ETag" = String, description = "Names the revision"))),
        (status = 200, description = "Replaced", body = StoredRecipeDocument,
            headers(("ETag" = String, description = "Names the revision"))),
    )
)]
pub(in crate::http) async fn put_recipe(
    State(app): State<App>,
    Path(name): Path<String>,
    _: NoQuery,
    headers: HeaderMap,
    JsonBody(document): JsonBody<RecipeDocument>,
) -> Result<Response, Problem> {
    let name = RecipeName::parse(&name).ok_or_else(|| {
        let detail = "a recipe's name has 1 to 64 small letters, digits, - or _, and begins with a letter or digit";
        Problem::new(Code::OptionInvalid, detail).with("field", "name")
    })?;
    let said = precondition(&headers)?;
    // Without a precondition, only a new name is accepted.
    let holds = said.clone().unwrap_or(Precondition::MustNotExist);
    match app.service.measuring.put_recipe(&name, &document.into(), holds).await {
        Ok(Put::Created(recipe)) => answer(StatusCode::CREATED, recipe),
        Ok(Put::Replaced(recipe)) => answer(StatusCode::OK, recipe),
        Err(crate::service::ServiceError::RecipeChanged { current_etag, .. }) if said.is_none() => Err(Problem::new(
            Code::PreconditionRequired,
            "there is a recipe of this name; replace it with If-Match and its ETag",
        )
        .with("current_etag", current_etag)),
        Err(error) => Err(error.into()),
    }
}

/// The precondition in the headers.
fn precondition(headers: &HeaderMap) -> Result<Option<Precondition>, Problem> {
    let invalid = |detail| Err(Problem::new(Code::HeaderInvalid, detail));
    let if_match = header_text(headers, &header::IF_MATCH)?;
    let if_none_match = header_text(headers, &header::IF_NONE_MATCH)?;
    match (if_match.as_deref().map(str::trim), if_none_match.as_deref().map(str::trim)) {
        (None, None) => Ok(None),
        (Some("*"), None) => Ok(Some(Precondition::MustExist)),
        (None, Some("*")) => Ok(Some(Precondition::MustNotExist)),
        (Some(tag), None) => match tag.strip_prefix('"').and_then(|tag| tag.strip_suffix('"')) {
            Some(tag) if !tag.contains('"') => Ok(Some(Precondition::Match(tag.to_owned()))),
            _ => invalid("If-Match must be * or one ETag in quotation marks, as it was received"),
        },
        (None, Some(_)) => invalid("If-None-Match must be * here"),
        (Some(_), Some(_)) => invalid("send If-Match or If-None-Match, not both"),
    }
}

fn answer(status: StatusCode, recipe: StoredRecipe) -> Result<Response, Problem> {
    let etag = HeaderValue::from_str(&format!("\"{}\"", recipe.etag));
    let etag = etag.map_err(|error| Problem::internal(error.to_string()))?;
    Ok((status, [(header::ETAG, etag)], Json(StoredRecipeDocument::from(recipe))).into_response())
}

impl From<StoredRecipe> for StoredRecipeDocument {
    fn from(recipe: StoredRecipe) -> Self {
        let StoredRecipe { name, recipe, revision, etag, created_at, updated_at } = recipe;
        Self { name, revision, etag, created_at, updated_at, recipe: recipe.into() }
    }
}
