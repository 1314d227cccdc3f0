//! Routes of CommonRoad scenarios (format 2020a): over the lanelets from the initial state of
//! a planning problem to its goal.

use std::collections::BTreeSet;
use std::path::Path;

use roxmltree::{Document, Node};
use shm_config::file::read_text;
use vehicle::{Point, Pose, pose};

use super::lanelets::{Lanelet, Lanelets, holding, joined, way};
use super::{Route, RouteError, Row};

/// Longest file, bytes: a scenario also holds each state of each other vehicle, which are
/// not used.
const BYTES_MAX: u64 = 64 << 20;

/// A planning problem's task.
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    /// Where the car begins, in the frame of the map.
    pub map_from_start: Pose,
    /// Its speed there, m/s.
    pub speed_mps: f64,
    /// The road to its goal.
    pub route: Route,
}

/// Where a goal is.
#[derive(Debug, Default)]
struct Goal {
    lanelets: BTreeSet<i64>,
    places: Vec<Point>,
}

/// Reads the first planning problem of a scenario. The route goes over successors; one that
/// needs a change of lanes is refused.
///
/// # Errors
/// A file that cannot be read or is longer than 64 MiB, that is no scenario, or whose goal
/// cannot be reached.
pub fn read(path: &Path) -> Result<Task, RouteError> {
    let text = read_text(path, BYTES_MAX).map_err(|error| RouteError::File {
        path: path.into(),
        error,
    })?;
    task(&text).map_err(|what| RouteError::Scenario {
        path: path.into(),
        what,
    })
}

fn task(text: &str) -> Result<Task, String> {
    let document = Document::parse(text).map_err(|error| error.to_string())?;
    let root = document.root_element();
    if !root.has_tag_name("commonRoad") {
        return Err("it is no CommonRoad scenario".into());
    }
    let mut lanelets = Lanelets::new();
    for node in children(root, "lanelet") {
        lanelets.insert(id(node, "id")?, lanelet(node)?);
    }
    let problem = child(root, "planningProblem")?;
    let initial = child(problem, "initialState")?;
    let start = point(child(child(initial, "position")?, "point")?)?;
    let heading_rad = number(child(child(initial, "orientation")?, "exact")?)?;
    let speed_mps = number(child(child(initial, "velocity")?, "exact")?)?;
    let goal = goal(child(problem, "goalState")?)?;
    let begins: Vec<i64> = holding(&lanelets, start).collect();
    if begins.is_empty() {
        return Err("the initial position is on no lanelet".into());
    }
    let mut ends = goal.lanelets;
    for place in goal.places {
        ends.extend(holding(&lanelets, place));
    }
    let rows = joined(&lanelets, &way(&lanelets, begins, &ends)?);
    Ok(Task {
        map_from_start: pose(start.x, start.y, heading_rad),
        speed_mps,
        route: Route::new(rows, false).map_err(|error| error.to_string())?,
    })
}

fn children<'a>(node: Node<'a, 'a>, name: &'static str) -> impl Iterator<Item = Node<'a, 'a>> {
    node.children()
        .filter(move |child| child.has_tag_name(name))
}

fn child<'a>(node: Node<'a, 'a>, name: &'static str) -> Result<Node<'a, 'a>, String> {
    let found = children(node, name).next();
    found.ok_or_else(|| format!("<{}> without <{name}>", node.tag_name().name()))
}

fn number(node: Node<'_, '_>) -> Result<f64, String> {
    let text = node.text().unwrap_or_default().trim();
    let number: Option<f64> = text.parse().ok().filter(|number: &f64| number.is_finite());
    number.ok_or_else(|| format!("<{}>: {text:?} is no number", node.tag_name().name()))
}

fn id(node: Node<'_, '_>, attribute: &str) -> Result<i64, String> {
    let text = node.attribute(attribute).unwrap_or_default();
    let wrong = |_| format!("<{}>: {attribute}={text:?}", node.tag_name().name());
    text.parse().map_err(wrong)
}

fn point(node: Node<'_, '_>) -> Result<Point, String> {
    Ok(Point::new(
        number(child(node, "x")?)?,
        number(child(node, "y")?)?,
    ))
}

fn bound(node: Node<'_, '_>) -> Result<Vec<Point>, String> {
    children(node, "point").map(point).collect()
}

fn lanelet(node: Node<'_, '_>) -> Result<Lanelet, String> {
    let left = bound(child(node, "leftBound")?)?;
    let right = bound(child(node, "rightBound")?)?;
    if left.len() != right.len() || left.len() < 2 {
        let (left, right) = (left.len(), right.len());
        return Err(format!(
            "a lanelet with {left} places to the left and {right} to the right"
        ));
    }
    let rows = left.iter().zip(&right).map(|(left, right)| {
        let half_m = (left - right).norm() / 2.0;
        Row {
            place: nalgebra::center(left, right),
            left_m: half_m,
            right_m: half_m,
        }
    });
    let successors = children(node, "successor").map(|node| id(node, "ref"));
    Ok(Lanelet {
        rows: rows.collect(),
        successors: successors.collect::<Result<_, _>>()?,
    })
}

fn goal(node: Node<'_, '_>) -> Result<Goal, String> {
    let mut goal = Goal::default();
    for shape in child(node, "position")?.children().filter(Node::is_element) {
        match shape.tag_name().name() {
            "lanelet" => {
                goal.lanelets.insert(id(shape, "ref")?);
            }
            "point" => goal.places.push(point(shape)?),
            "rectangle" | "circle" => goal.places.push(point(child(shape, "center")?)?),
            other => return Err(format!("a goal with <{other}>")),
        }
    }
    Ok(goal)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bounds(from: (f64, f64), to: (f64, f64)) -> String {
        let point = |x: f64, y: f64| format!("<point><x>{x}</x><y>{y}</y></point>");
        let (left, right) = ((0.0, 2.0), (0.0, -2.0));
        let side =
            |(dx, dy): (f64, f64)| point(from.0 + dx, from.1 + dy) + &point(to.0 + dx, to.1 + dy);
        format!(
            "<leftBound>{}</leftBound><rightBound>{}</rightBound>",
            side(left),
            side(right)
        )
    }

    /// Two lanelets behind each other and one beside them; the goal is the given position.
    fn scenario(goal: &str) -> String {
        let first = bounds((0.0, 0.0), (50.0, 0.0));
        let second = bounds((50.0, 0.0), (90.0, 3.0));
        let beside = bounds((0.0, 4.0), (50.0, 4.0));
        format!(
            "<commonRoad>\
             <lanelet id='1'>{first}<successor ref='2'/></lanelet>\
             <lanelet id='2'>{second}<predecessor ref='1'/></lanelet>\
             <lanelet id='3'>{beside}</lanelet>\
             <planningProblem id='9'><initialState>\
             <position><point><x>5</x><y>0.5</y></point></position>\
             <velocity><exact>7</exact></velocity><orientation><exact>0.1</exact></orientation>\
             </initialState><goalState><position>{goal}</position></goalState></planningProblem>\
             </commonRoad>"
        )
    }

    #[test]
    fn a_route_goes_over_successors_to_the_goal() {
        for goal in [
            "<lanelet ref='2'/>",
            "<circle><radius>2</radius><center><x>80</x><y>2</y></center></circle>",
        ] {
            let task = task(&scenario(goal)).expect(goal);
            assert_eq!(
                (task.speed_mps, task.map_from_start),
                (7.0, pose(5.0, 0.5, 0.1))
            );
            let length_m = 50.0 + 40.0_f64.hypot(3.0);
            assert!((task.route.length_m() - length_m).abs() < 1e-9);
            let (_, left_m, right_m) = task.route.at(10.0);
            assert_eq!((left_m, right_m), (2.0, 2.0));
        }
    }

    #[test]
    fn a_file_that_is_too_long_is_refused_by_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("long.xml");
        let file = std::fs::File::create(&path).expect("a file");
        file.set_len(BYTES_MAX + 1).expect("its length");
        let error = read(&path).expect_err("refused").to_string();
        assert!(error.contains("long.xml: is longer than"), "{error}");
    }

    #[test]
    fn what_gives_no_route_is_said_in_one_line() {
        let refused = |text: &str| task(text).expect_err(text);
        assert!(refused("<osm/>").contains("no CommonRoad scenario"));
        assert!(refused("<commonRoad>").lines().count() == 1);
        assert!(refused("<commonRoad/>").contains("without <planningProblem>"));
        let goal = "<lanelet ref='3'/>";
        assert!(refused(&scenario(goal)).contains("no way over successors"));
        let away = scenario(goal).replace("<x>5</x>", "<x>-500</x>");
        assert!(refused(&away).contains("on no lanelet"));
        let wrong = scenario(goal).replace("<exact>7</exact>", "<exact>nan</exact>");
        assert!(refused(&wrong).contains("is no number"));
        // A circle of successors ends.
        let circle = scenario(goal).replace("<predecessor ref='1'/>", "<successor ref='1'/>");
        assert!(refused(&circle).contains("no way over successors"));
    }
}
