
define ptr @{name}(ptr %frame) {{
entry:
{sizes}
  %outer = sub i64 %rank, 1
  br label %count
count:
  %axis = phi i64 [ 0, %entry ], [ %next_axis, %multiply ]
  %samples = phi i64 [ 1, %entry ], [ %more, %multiply ]
  %counted = icmp sge i64 %axis, %outer
  br i1 %counted, label %gather, label %multiply
multiply:
  %size_place = getelementptr i64, ptr %sizes, i64 %axis
  %size = load i64, ptr %size_place
  %more = mul i64 %samples, %size
  %next_axis = add i64 %axis, 1
  br label %count
gather:
  %data = alloca ptr, i64 {arrays}
{loads}
  %result = load ptr, ptr %results
  %out_place = getelementptr i8, ptr %result, i64 24
  %out = load ptr, ptr %out_place
  call void @{name}.samples(ptr %data, ptr %out, i64 %samples)
  ret ptr null
}}
