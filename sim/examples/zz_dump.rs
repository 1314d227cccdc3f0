//! temporary
use sim::map::*; use sim::lane::*;
fn main(){ let a:Vec<String>=std::env::args().skip(1).collect(); let blocks=match a[0].parse(){Ok(n)=>BlockPlan::Random(n),Err(_)=>BlockPlan::parse(&a[0]).unwrap()};
 let c=MapConfig{blocks,lane_count:a[1].parse().unwrap(),lane_width_m:a[2].parse().unwrap(),..Default::default()};
 for s in &a[3..]{ let m=Map::generate(&c,s.parse().unwrap()).unwrap(); let n=&m.network; for r in 0..n.roads().len(){ let r=sim::road::RoadId(r as u16); for (i,l) in n.lanes_of(r).iter().enumerate(){ let (p,q)=(l.start_world,l.end_world); let ph=match l.curve{Curve::Arc(a)=>a.start_phase_rad,_=>0.0}; println!("{s} {} {i} {:?} {:?} {:?} {:?} {:?} {:?}",n.road_name(r),l.length_m,p.x,p.y,q.x,q.y,ph);} } } }
